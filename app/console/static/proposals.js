// Proposals of a map: queries that matched a place although they look unlike its views, to be taken or dismissed.

import { call } from "./api.js";
import { confirmed, count, folded, h, moment, problemBox } from "./dom.js";
import { image } from "./images.js";
import { dismiss, keeping } from "./keeping.js";

/** The sections of the inbox: what is proposed, and how much is kept. */
export function proposalSections(path, found, tell) {
  return [
    h(
      "section",
      { class: "panel" },
      h("h2", {}, found.count ? `${count(found.count, "place")} seen in another light` : "No place in another light"),
      h("p", { class: "quiet" }, situation(found)),
      h(
        "ul",
        { class: "matches" },
        found.proposals.map((proposal) => card(path, proposal, tell)),
      ),
    ),
    keeping({
      path,
      setting: "keep_matches",
      most: found.keep_matches,
      kept: found.kept,
      heading: ["Matches in another light are kept", "Keep matches in another light"],
      about:
        "The newest are kept, with a small image of each and no metadata, until they are taken or dismissed. Kept " +
        "are queries that matched although they look unlike what they matched, as at night; and how well each view " +
        "is matched from day to day, so that Health can tell of places that age.",
      label: "Number of matches",
      kind: "match in another light",
      tell,
    }),
  ];
}

function situation({ keep_matches: most, kept, count: places, proposals }) {
  if (most === 0) return "Off: queries that match in another light are not kept. Switch it on below.";
  if (kept === 0) return "No query has matched in another light since this was switched on.";
  const first = proposals.length < places ? `; the first ${proposals.length} places are shown` : "";
  return `${count(kept, "query", "queries")} matched${first}. As views they make the next queries in that light sure.`;
}

function card(path, proposal, tell) {
  const wrong = h("div");
  const address = `${path}/proposals/${encodeURIComponent(proposal.id)}`;
  const name = proposal.place ?? "a view without a place";
  const unconfirmed = proposal.confirmed === 0;

  async function taken() {
    const text = "No other query matched this place, so that it may be another one. Compare both images first.";
    if (unconfirmed && !(await confirmed({ title: "Take it unconfirmed?", text, action: "Take it" }))) return;
    try {
      const { views } = await call("POST", address, { json: { unconfirmed } });
      tell(`${count(views.length, "photo")} of ${name} taken.`);
    } catch (error) {
      wrong.replaceChildren(problemBox(error));
    }
  }

  const dismissed = () =>
    dismiss({ title: "Dismiss this proposal?", number: proposal.count, address, wrong, tell });

  return h(
    "li",
    { class: "match proposal" },
    h(
      "div",
      { class: "sides" },
      image(proposal.links.image, `The query of ${moment(proposal.first_at)}`, { width: 256, height: 192 }),
      image(`${proposal.links.view}/thumbnail`, `The view of ${name} that it matched`, { width: 256, height: 192 }),
    ),
    h("h3", {}, name),
    h(
      "p",
      { class: "quiet" },
      `${count(proposal.count, "query", "queries")}, ${proposal.confirmed} confirmed, scores `,
      `${proposal.lowest_score.toFixed(2)} to ${proposal.highest_score.toFixed(2)}, ${moment(proposal.last_at)}`,
    ),
    proposal.queries.length > 1 &&
      folded("Its other photos", () =>
        h(
          "div",
          { class: "sides" },
          proposal.queries
            .slice(1)
            .map((id) => image(`${path}/proposals/${encodeURIComponent(id)}/image`, "Another query of this place")),
        ),
      ),
    wrong,
    h(
      "div",
      { class: "row" },
      h(
        "button",
        { type: "button", class: unconfirmed ? null : "first", onclick: taken },
        unconfirmed ? "Take it …" : "Take",
      ),
      h("button", { type: "button", class: "danger", onclick: dismissed }, "Dismiss proposal …"),
    ),
  );
}
