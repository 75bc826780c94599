// What changed at a place, in words and as a drawing; compared when somebody asks for it.

import { call } from "./api.js";
import { announce, field, h, moment, percent, problemBox, sentence } from "./dom.js";
import { drawing } from "./images.js";
import { near } from "./plan.js";

const MOST_OTHERS = 100;

/** A button that fetches what changed from `address()`, and shows it below. Gives {element, clear}. */
export function whatChanged(text, address) {
  const shown = h("div");
  async function compare() {
    shown.replaceChildren(h("p", { class: "quiet" }, "Comparing both photos; this takes some seconds …"));
    try {
      const found = await call("GET", address());
      shown.replaceChildren(...outcome(found));
      announce(shown.textContent);
    } catch (error) {
      const again = [429, 503].includes(error.status) && "The service is busy: try again in a few seconds.";
      shown.replaceChildren(problemBox(error), again && h("p", {}, again));
    }
  }
  const button = h("button", { type: "button", onclick: compare }, text);
  return { element: h("div", { class: "changes spaced" }, button, shown), clear: () => shown.replaceChildren() };
}

const REFUSED = {
  "not-aligned": "The photos cannot be laid over one another",
  "image-not-kept": "The earlier photo was not kept",
  "no-match": "There is no earlier photo to compare with",
  busy: "Not compared yet",
};

/** The elements that show the answer to a comparison. */
function outcome(found) {
  if (found.status !== "compared")
    return [h("h3", {}, REFUSED[found.status] ?? "Not compared"), h("p", {}, sentence(found.detail))];
  const share = percent(found.compared);
  const compared = `${share} of the later photo could be compared; the rest is seen in one alone, or moves by itself.`;
  return [
    h("h3", {}, found.changes.length ? "What changed" : "Nothing changed that could be told"),
    h(
      "ul",
      { class: "told-changes" },
      found.changes.map((one) => h("li", { class: one.kind }, changeLine(one))),
    ),
    h("p", { class: "quiet" }, compared, " Names of things are guesses."),
    drawing(found.links.drawing, "Both photos, with what changed", "Then on the left, now on the right."),
  ];
}

function changeLine({ kind, label, instead, confidence }) {
  return [
    h("strong", {}, { gone: "Gone", new: "New", moved: "Moved" }[kind]),
    ` ${label}`,
    instead && instead !== label && ` (${instead} ${kind === "gone" ? "is there now" : "was there"})`,
    h("span", { class: "quiet" }, `, ${percent(confidence).replace(" ", "\u00a0")}`),
  ];
}

/** A choice of the other views of the place that a view shows, and what changed between the two. */
export function changesSince(view, map) {
  const box = h("div");
  others(view, map.ranking.same_place_m).then(
    (found) => found.length > 0 && box.append(...chooser(view, found)),
    (error) => box.append(problemBox(error)),
  );
  return box;
}

function chooser(view, found) {
  const before = found.filter((other) => taken(other) < taken(view));
  const select = h(
    "select",
    { onchange: () => changed.clear() },
    found.map((other) =>
      h("option", { value: other.id }, `${moment(taken(other))}${other.filename ? `, ${other.filename}` : ""}`),
    ),
  );
  select.value = (before.at(-1) ?? found[0]).id;
  const changed = whatChanged("What changed?", () => {
    const other = found.find((one) => one.id === select.value);
    const [then, now] = taken(other) < taken(view) ? [other, view] : [view, other];
    return `/views/${encodeURIComponent(now.id)}/changes?since=${encodeURIComponent(then.id)}`;
  });
  return [h("h3", {}, "Compare with"), field("Another view from here", select), changed.element];
}

/** Described views of the same place, or near it where it has no name, earliest first. */
async function others(view, within) {
  const { place, position } = view;
  const query = { map: view.map, state: "ready", limit: MOST_OTHERS };
  if (place !== null) query.place = place;
  else if (within === 0) return []; // only a name makes one place of two views there
  else {
    const around = near(position, within);
    if (!around) return [];
    Object.assign(query, around);
  }
  const { views } = await call("GET", "/views", { query });
  return views.filter((one) => one.id !== view.id).sort((one, other) => (taken(one) < taken(other) ? -1 : 1));
}

const taken = (view) => view.captured_at ?? view.enrolled_at;
