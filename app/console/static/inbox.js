// The inbox of a map: queries that matched nothing, to be named, and places in another light, to be taken.

import { call } from "./api.js";
import { chooseMap } from "./choice.js";
import { announce, count, field, folded, h, moment, problemBox, screenProblem } from "./dom.js";
import { image } from "./images.js";
import { dismiss, keeping } from "./keeping.js";
import { mapHead } from "./parts.js";
import { FRAMES, typedPosition } from "./positions.js";
import { proposalSections } from "./proposals.js";

const AT_FIRST = 20;
const MOST = 500;

export function inboxScreen(name) {
  const path = `/maps/${encodeURIComponent(name)}`;
  const notice = h("div");
  const shown = h("div", {}, h("p", {}, "Loading …"));
  const frame = h(
    "select",
    {},
    FRAMES.map(([value, text]) => h("option", { value }, text)),
  );
  const typed = new Map(); // id of a spot -> its inputs: naming one leaves what is typed of the others
  let limit = AT_FIRST;
  let first = true;

  async function load() {
    try {
      const [map, inbox, proposals] = await Promise.all([
        call("GET", path),
        call("GET", `${path}/unknown`, { query: { limit } }),
        call("GET", `${path}/proposals`, { query: { limit: MOST } }),
      ]);
      if (!shown.isConnected) return; // another screen is shown by now
      chooseMap(name);
      shown.replaceChildren(spots(map, inbox), kept(inbox), ...proposalSections(path, proposals, tell));
    } catch (error) {
      shown.replaceChildren(screenProblem(error));
    }
  }

  function spots(map, inbox) {
    if (first && typeof map.extent?.minimum.lat === "number") frame.value = "degrees";
    first = false;
    const more = h("button", {
      type: "button",
      onclick: () => {
        limit = MOST;
        load();
      },
    });
    more.append(`Show ${inbox.count > MOST ? `the first ${MOST}` : `all ${inbox.count}`}`);
    return h(
      "section",
      { class: "panel" },
      h("h2", {}, inbox.count ? `${count(inbox.count, "spot")} that this map does not know` : "Nothing to name"),
      h("p", { class: "quiet" }, situation(inbox)),
      inbox.count > 0 && h("div", { class: "row spot-frame" }, field("Positions are in", frame)),
      h(
        "ul",
        { class: "matches" },
        inbox.places.map(spot),
      ),
      inbox.count > inbox.places.length && limit < MOST && h("p", {}, more),
    );
  }

  function situation({ keep_queries: most, kept, examined }) {
    if (most === 0) return "Off: queries that match nothing are not kept. Switch it on below.";
    if (kept === 0) return "No query has matched nothing since this was switched on.";
    const newest = examined < kept ? `; the newest ${examined.toLocaleString("en-GB")} of them are shown by spot` : "";
    return `${count(kept, "query", "queries")} matched nothing${newest}. What is named here is known from then on.`;
  }

  function inputsOf(id) {
    if (!typed.has(id))
      typed.set(id, {
        label: h("input", { required: true, maxlength: 200 }),
        where: h("input", { placeholder: "12.5, 3.0, 90", spellcheck: "false" }),
      });
    return typed.get(id);
  }

  function spot(place) {
    const wrong = h("div");
    const { label, where } = inputsOf(place.id);
    const seen = `Seen ${place.count === 1 ? "once" : `${place.count} times`}`;
    const address = `${path}/unknown/${encodeURIComponent(place.id)}`;

    async function named(event) {
      event.preventDefault();
      try {
        const parts = Object.entries(typedPosition(where.value.trim(), frame.value));
        const position = Object.fromEntries(parts.map(([key, text]) => [key, numberOf(text)]));
        const json = { place: label.value.trim(), ...(parts.length && { position }) };
        const { views } = await call("POST", address, { json });
        tell(`${count(views.length, "photo")} of ${json.place} enrolled.`);
      } catch (error) {
        wrong.replaceChildren(problemBox(error));
      }
    }

    const dismissed = () =>
      dismiss({ title: "Dismiss this spot?", number: place.count, address, wrong, tell });

    return h(
      "li",
      { class: "match spot" },
      image(place.links.image, `${seen}, first ${moment(place.first_at)}`, { width: 256, height: 192 }),
      h("h3", {}, seen),
      h("p", { class: "quiet" }, span(place)),
      place.queries.length > 1 &&
        folded("Its other photos", () =>
          h(
            "div",
            { class: "sides" },
            place.queries
              .slice(1)
              .map((id) => image(`${path}/unknown/${encodeURIComponent(id)}/image`, "Another photo of this spot")),
          ),
        ),
      wrong,
      h(
        "form",
        { onsubmit: named },
        h("div", { class: "spaced" }, field("What place is it?", label)),
        h("div", { class: "spaced" }, field("Position, if known", where)),
        h(
          "div",
          { class: "row" },
          h("button", { type: "submit", class: "first" }, "Name it"),
          h("button", { type: "button", class: "danger", onclick: dismissed }, "Dismiss …"),
        ),
      ),
    );
  }

  function kept(inbox) {
    return keeping({
      path,
      setting: "keep_queries",
      most: inbox.keep_queries,
      kept: inbox.kept,
      heading: ["Queries that match nothing are kept", "Keep queries that match nothing"],
      about:
        "The newest are kept, with a small image of each and no metadata, until they are named or dismissed. Not " +
        "kept are poor photos and queries with filters.",
      label: "At most",
      kind: "match nothing",
      tell,
    });
  }

  function tell(text) {
    notice.replaceChildren(h("p", { class: "done" }, text));
    announce(text);
    load();
  }

  return { element: h("div", {}, mapHead(name, "inbox"), notice, shown), enter: load };
}

const span = ({ count: number, first_at: first, last_at: last }) =>
  number === 1 || moment(first) === moment(last) ? moment(last) : `${moment(first)} to ${moment(last)}`;

/** A number where it is one; other text is left for the service to refuse. */
const numberOf = (text) => (Number.isFinite(Number(text)) ? Number(text) : text);
