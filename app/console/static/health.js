// What a map lacks or suffers from: twins, places that age, duplicates, missing directions, gaps, single views.

import { call } from "./api.js";
import { chooseMap } from "./choice.js";
import { count, facts, folded, h, place as inWords, problemBox, screenProblem, sentence, table } from "./dom.js";
import { image, thumbnail } from "./images.js";
import { mapHead } from "./parts.js";
import { outline, plan } from "./plan.js";
import { openView } from "./view.js";

const AT_FIRST = 20;
const MOST = 500; // findings of a kind in one answer
const A_PORTION = 6;
const ROWS_A_PORTION = 50;
const MOST_IMAGES = 4;
const SIDES = ["north", "east", "south", "west"];

/** Kinds of findings: code, title, what they are, whether they are unfolded at once. */
const KINDS = [
  ["twins", "Twins", "Places that the map takes for each other.", true],
  ["ageing", "Ageing places", "Places whose scores fall from month to month.", true],
  ["never-matched", "Never matched", "Places that no query was matched with while others were.", false],
  ["duplicates", "Duplicates", "Views that add nothing to one another.", true],
  ["missing-directions", "Missing directions", "Places that are not seen towards every side.", false],
  ["gap", "Gaps", "Stretches without views, between parts of the map that lie apart.", false],
  ["single-view", "Single views", "Places that were enrolled once.", false],
];

/** A remedy without what a program would call: here a view is edited by its photo. */
const withoutCalls = (remedy) => remedy.replace(/ \((DELETE|PATCH) [^)]*\)/g, "");

export function healthScreen(name) {
  const path = `/maps/${encodeURIComponent(name)}`;
  const shown = h("div", {}, h("p", {}, "Examining the map …"));
  const reached = new Map(); // code -> how many of its findings are shown
  const unfolded = new Map(KINDS.map(([code, , , open]) => [code, open]));
  let map = null;

  async function load() {
    try {
      const [about, health] = await Promise.all([
        call("GET", path),
        call("GET", `${path}/health`, { query: { limit: AT_FIRST } }),
      ]);
      map = about;
      if (!shown.isConnected) return; // another screen is shown by now
      chooseMap(name);
      const found = KINDS.filter(([code]) => health.counts[code] > 0);
      const groups = new Map(found.map((kind) => [kind[0], group(kind, health)]));
      shown.replaceChildren(summary(health, groups), ...groups.values());
    } catch (error) {
      shown.replaceChildren(screenProblem(error));
    }
  }

  function summary(health, groups) {
    const chips = KINDS.map(([code, title]) => {
      const number = health.counts[code] ?? 0;
      const text = `${title}: ${number.toLocaleString("en-GB")}`;
      const go = () => {
        const details = groups.get(code).querySelector("details");
        details.open = true;
        details.querySelector("summary").focus();
      };
      const button = number > 0 && h("button", { type: "button", onclick: go }, text);
      return h("li", {}, button || h("span", { class: "none" }, text));
    });
    const compared =
      health.compared < health.examined
        ? `${health.compared.toLocaleString("en-GB")} so far; twins are found among these. ` +
          "The service compares in the background, unless REVISIT_COMPARE says otherwise."
        : "all of them";
    return h(
      "section",
      { class: "panel" },
      h("h2", {}, groups.size ? "What it lacks or suffers from" : "Nothing to mend was found"),
      h("ul", { class: "chips" }, chips),
      facts([
        ["Views examined", `${health.examined.toLocaleString("en-GB")} of ${health.views.toLocaleString("en-GB")}`],
        ["Compared with the map", health.examined > 0 ? compared : null],
        ["Revision", health.revision],
      ]),
    );
  }

  function group([code, title, about], health) {
    const total = health.counts[code];
    const first = health.findings.filter((one) => one.code === code);
    const all = async () => {
      if (first.length >= total) return first;
      return (await call("GET", `${path}/health`, { query: { code, limit: MOST } })).findings;
    };
    const make = { "missing-directions": directions, "single-view": singles, gap: coverage }[code] ?? pictured;
    const details = folded(h("h2", {}, `${title}: ${total.toLocaleString("en-GB")}`), () =>
      h("div", {}, h("p", { class: "quiet" }, about), make(first, all, total)),
    );
    details.open = unfolded.get(code);
    details.addEventListener("toggle", () => unfolded.set(code, details.open));
    return h("section", { class: "panel finds", "data-code": code }, details);
  }

  function pictured(first, all, total) {
    const code = first[0].code;
    return byPortions(first, all, total, A_PORTION, finding, reached.get(code), (number) => reached.set(code, number));
  }

  function finding(one) {
    const images = h("div", { class: "sides" });
    fillWithViews(images, one);
    return h(
      "section",
      { class: "finding" },
      h("p", {}, sentence(one.detail)),
      images,
      h("p", { class: "quiet" }, sentence(withoutCalls(one.remedy))),
      one.proposal && refreshing(one),
    );
  }

  /** The photo that a query left of an ageing place, and the way to where it is taken. */
  function refreshing(one) {
    const kept = `${path}/proposals/${encodeURIComponent(one.proposal)}/image`;
    return h(
      "p",
      { class: "refreshing" },
      image(kept, `${one.places[0] ?? "The place"}, as a query saw it`, { width: 256, height: 192 }),
      h("a", { href: `#maps/${encodeURIComponent(name)}/inbox` }, "Take or dismiss it"),
    );
  }

  /** Twins get a column for each place, other findings their views side by side. */
  async function fillWithViews(images, one) {
    const answers = await Promise.allSettled(one.views.map((id) => call("GET", `/views/${encodeURIComponent(id)}`)));
    const views = answers.filter((answer) => answer.status === "fulfilled").map((answer) => answer.value);
    const sides = grouped(views, nameOf);
    const picked = one.code === "twins" ? [...sides.values()].flatMap((side) => side.slice(0, 2)) : views;
    images.replaceChildren(...picked.slice(0, MOST_IMAGES).map(card));
    const left = one.count - Math.min(picked.length, MOST_IMAGES);
    if (one.code === "duplicates" && left > 0) images.append(h("p", { class: "quiet" }, `and ${left} more`));
  }

  function card(view) {
    const name = nameOf(view);
    return h(
      "button",
      { type: "button", class: "side", "aria-label": `Open ${name}`, onclick: () => openView(view, map, load) },
      thumbnail(view, map, 512, { width: 256, height: 192 }),
      h("span", {}, name),
      h("span", { class: "quiet" }, view.place && inWords(view.position)),
    );
  }

  function directions(first, all, total) {
    return filledBox(async () => {
      const findings = await all();
      const groups = [...grouped(findings, (one) => towards(one.headings))].sort((a, b) => b[1].length - a[1].length);
      return [
        groups.map(([sides, some]) => folded(`Not towards ${sides}: ${count(some.length, "place")}`, () => rows(some))),
        beyond(findings.length, total),
      ];
    });
  }

  const singles = (first, all, total) =>
    filledBox(async () => {
      const findings = await all();
      return [rows(findings), beyond(findings.length, total)];
    });

  /** A table of places, with where they are and a view to look at. */
  function rows(findings) {
    const row = (one) => [
      one.places[0] ?? "without a name",
      inWords(one.position) ?? "–",
      one.views.length > 0 &&
        h(
          "button",
          { type: "button", "aria-label": `See ${one.places[0] ?? inWords(one.position)}`, onclick: () => open(one) },
          "See",
        ),
    ];
    const box = h("div", { class: "table tall", tabindex: "0", role: "region", "aria-label": "Places" });
    const list = (some) => table(["Place", "Where to stand", "View"], some.map(row));
    box.append(list(findings.slice(0, ROWS_A_PORTION)));
    if (findings.length > ROWS_A_PORTION) {
      const more = h("button", { type: "button", onclick: () => box.replaceChildren(list(findings)) });
      more.append(`All ${findings.length.toLocaleString("en-GB")}`);
      box.append(h("p"), more);
    }
    return box;
  }

  async function open(one) {
    try {
      openView(await call("GET", `/views/${encodeURIComponent(one.views[0])}`), map, load);
    } catch (error) {
      shown.prepend(problemBox(error));
    }
  }

  function coverage(first, all, total) {
    const points = first
      .filter((one) => one.position)
      .map((one) => ({ position: one.position, kind: "first", name: one.places.join(" – ") }));
    const picture = plan(points);
    // Without the other views the plan still shows the gaps.
    if (points.length) outline(name, picture.add, () => picture.element.isConnected).catch(() => {});
    return h("div", {}, points.length > 0 && picture.element, pictured(first, all, total));
  }

  return { element: h("div", {}, mapHead(name, "health"), shown), enter: load };
}

/** A box that is filled when `made()` has promised its content. */
function filledBox(made) {
  const box = h("div", {}, h("p", { class: "quiet" }, "Loading …"));
  made().then(
    (content) => box.replaceChildren(...content.flat().filter(Boolean)),
    (error) => box.replaceChildren(problemBox(error)),
  );
  return box;
}

/**
 * A list of findings that shows `portion` more at a time, `before` at first. Those beyond `first`, the findings of the
 * first answer, are fetched by `all()` when somebody goes on to them. `shownChanged(number)` is called with how many
 * are shown.
 */
function byPortions(first, all, total, portion, make, before = portion, shownChanged = () => {}) {
  let items = first;
  let shown = 0;
  const list = h("div");
  const next = h("button", { type: "button", onclick: () => more() }, "More");
  async function more(number = portion) {
    next.disabled = true;
    try {
      if (shown + number > items.length) items = await all();
      list.append(...items.slice(shown, shown + number).map(make));
      shown = Math.min(shown + number, items.length);
      shownChanged(shown);
      next.hidden = shown >= items.length;
      if (next.hidden) list.append(beyond(items.length, total) ?? "");
    } catch (error) {
      list.append(problemBox(error));
    } finally {
      next.disabled = false;
    }
  }
  more(before);
  return h("div", {}, list, next);
}

function beyond(listed, total) {
  if (listed >= total) return null;
  const [few, whole] = [listed, total].map((number) => number.toLocaleString("en-GB"));
  return h("p", { class: "quiet" }, `The first ${few} of ${whole}, the most important ones.`);
}

function grouped(items, keyOf) {
  const groups = new Map();
  for (const item of items) groups.set(keyOf(item), [...(groups.get(keyOf(item)) ?? []), item]);
  return groups;
}

const nameOf = (view) => view.place ?? inWords(view.position) ?? `view ${view.id.slice(-6)}`;
const towards = (headings) => headings.map((one) => (one % 90 ? `${one}°` : SIDES[(one / 90) % 4])).join(", ");
