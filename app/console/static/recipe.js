// Describing a map anew: another recipe, tried in the shadow of the present one, and the table of what it changes.

import { call } from "./api.js";
import { chooseMap } from "./choice.js";
import {
  announce,
  checkbox,
  confirmed,
  count,
  decimals,
  facts,
  field,
  folded,
  h,
  percent,
  problemBox,
  screenProblem,
  table,
} from "./dom.js";
import { image } from "./images.js";
import { follow } from "./jobs.js";
import { mapHead } from "./parts.js";

const QUERIES = 100;
const MOST_QUERIES = 200;
const STATUSES = [
  ["matched", "Matched"],
  ["ambiguous", "Ambiguous"],
  ["no_match", "No match"],
  ["refused", "Nothing static"],
];
const WORDS = Object.fromEntries(STATUSES);

export function recipeScreen(name) {
  const path = `/maps/${encodeURIComponent(name)}`;
  const notice = h("div");
  const shown = h("div", {}, h("p", {}, "Loading …"));
  let left = false;

  async function load() {
    try {
      const map = await call("GET", path);
      const shadow = map.shadow && (await call("GET", `${path}/shadow`));
      if (left) return;
      chooseMap(name);
      shown.replaceChildren(...(shadow ? shadowSections(shadow) : [anew(map)]));
    } catch (error) {
      shown.replaceChildren(screenProblem(error));
    }
  }

  function tell(text) {
    notice.replaceChildren(h("p", { class: "done" }, text));
    announce(text);
    return load();
  }

  function anew(map) {
    const wrong = h("div");
    const inputs = {
      labels: h("textarea", { value: map.recipe.labels.join(", "), required: true }),
      dynamic: h("textarea", { value: map.recipe.dynamic.join(", ") }),
      preset: h("input", { value: map.ranking.preset, spellcheck: "false", required: true }),
    };
    const renewed = checkbox("Parameters and ranking as the preset has them now, none of the map's own");
    const queries = h("input", { type: "number", min: 1, max: MOST_QUERIES, required: true, value: String(QUERIES) });

    async function begun(shadow) {
      const list = (input) =>
        input.value
          .split(",")
          .map((one) => one.trim())
          .filter(Boolean);
      const wanted = { labels: list(inputs.labels), dynamic: list(inputs.dynamic) };
      const preset = inputs.preset.value.trim();
      if (preset !== map.ranking.preset || renewed.box.checked) wanted.preset = preset;
      if (shadow) wanted.shadow = Number(queries.value);
      try {
        const job = await call("POST", `${path}/recipe`, { json: wanted });
        if (shadow) await tell("The views are being described in the shadow; the map answers as before.");
        else await watched(job, wrong, "The map is described anew.");
      } catch (error) {
        wrong.replaceChildren(problemBox(error));
      }
    }

    return h(
      "section",
      { class: "panel" },
      h("h2", {}, "Describe all views anew"),
      h(
        "p",
        {},
        "Other labels, other things that move, or another preset. In the shadow the map answers as before, while the " +
          "other recipe describes its views and answers the last queries beside it; then you decide.",
      ),
      wrong,
      h(
        "form",
        {
          onsubmit: (event) => {
            event.preventDefault();
            return begun(true);
          },
        },
        h("div", { class: "spaced" }, field("Labels, with commas", inputs.labels)),
        h("div", { class: "spaced" }, field("Those that move", inputs.dynamic)),
        h(
          "div",
          { class: "fields" },
          field("Preset", inputs.preset),
          field("Queries to compare", queries),
        ),
        h("div", { class: "spaced" }, renewed.label),
        differences(map.preset_differences),
        h(
          "div",
          { class: "row" },
          h("button", { type: "submit", class: "first" }, "Try it in the shadow"),
          h("button", { type: "button", onclick: () => begun(false) }, "Change over without trying"),
        ),
      ),
    );
  }

  /** Show how far a job is in `where`, and say `text` when it has ended well. */
  async function watched(job, where, text) {
    const draw = (now) => where.replaceChildren(progressOf(now));
    draw(job);
    const ended = await follow(job, draw, () => !left);
    if (left) return;
    if (ended.state === "done") await tell(text);
    else where.replaceChildren(problemBox({ title: `The job is ${ended.state}`, detail: ended.failure?.detail ?? "" }));
  }

  function shadowSections(shadow) {
    const wrong = h("div");
    const ready = shadow.state === "ready";
    const step = h("div");
    if (!ready)
      call("GET", `/jobs/${encodeURIComponent(shadow.job)}`)
        .then((job) => watched(job, step, "Both recipes have answered."))
        .catch((error) => step.replaceChildren(problemBox(error)));

    async function switched() {
      try {
        await watched(await call("POST", `${path}/shadow/switch`), wrong, "The map has changed over.");
      } catch (error) {
        wrong.replaceChildren(problemBox(error));
      }
    }

    async function discarded() {
      const text = "Its descriptions are deleted. The map keeps the recipe that it has.";
      if (!(await confirmed({ title: "Discard the shadow?", text, action: "Discard it" }))) return;
      try {
        await call("DELETE", `${path}/shadow`);
        await tell("The shadow is discarded.");
      } catch (error) {
        wrong.replaceChildren(problemBox(error));
      }
    }

    const about = h(
      "section",
      { class: "panel" },
      h("h2", {}, ready ? "A shadow is ready" : "A shadow is being made"),
      h("p", {}, "The map answers by its present recipe. ", ready && "What the other one changes is below."),
      facts([
        ["Labels", shadow.recipe.labels.join(", ")],
        ["Those that move", shadow.recipe.dynamic.join(", ") || "none"],
        ["Preset", shadow.ranking.preset],
        ["Queries wanted", shadow.wanted],
      ]),
      step,
      wrong,
      h(
        "div",
        { class: "row" },
        ready && h("button", { type: "button", class: "first", onclick: switched }, "Change over to it"),
        h("button", { type: "button", class: "danger", onclick: discarded }, "Discard it …"),
      ),
    );
    return ready ? [about, totalsSection(shadow.table), rowsSection(path, shadow.table)] : [about];
  }

  return {
    element: h("div", {}, mapHead(name, "recipe"), notice, shown),
    enter: load,
    leave: () => {
      left = true;
    },
  };
}

/** Where the map is not as its preset, to be opened; nothing where it is. */
function differences(listed) {
  const shown = (value) => (value === null ? "none" : JSON.stringify(value));
  const rows = listed.map((one) => [one.parameter, shown(one.value), shown(one.preset)]);
  const title = `${count(rows.length, "parameter")} ${rows.length === 1 ? "differs" : "differ"} from the preset`;
  const heads = ["Parameter", "Here", "Preset"];
  const region = { class: "table", tabindex: "0", role: "region", "aria-label": title };
  return rows.length > 0 && folded(title, () => h("div", region, table(heads, rows)));
}

function progressOf({ state, progress }) {
  const { done, total } = progress ?? { done: 0, total: 0 };
  return h(
    "p",
    { class: "quiet" },
    h("progress", { value: done, max: Math.max(total, 1), "aria-label": "Progress" }),
    ` ${state}, ${done} of ${total} images`,
  );
}

function totalsSection({ totals, old_views: oldViews, new_views: newViews }) {
  const rows = [
    ["Views described", oldViews, newViews],
    ...STATUSES.map(([key, text]) => [text, totals.old[key], totals.new[key]]),
    totals.known > 0 && [`Right first place, of ${totals.known} known`, totals.old.right, totals.new.right],
    ["Search, mean ms", decimals(totals.old.search_ms, 1), decimals(totals.new.search_ms, 1)],
    ["Describe, mean ms", decimals(totals.old.describe_ms, 1), decimals(totals.new.describe_ms, 1)],
  ].filter(Boolean);
  return h(
    "section",
    { class: "panel" },
    h("h2", {}, "What changes"),
    h(
      "p",
      {},
      `Of ${count(totals.queries, "query", "queries")}, ${totals.agree} are answered alike: `,
      `${totals.changed_first} have another first place, ${totals.became_matched} became matched, `,
      `${totals.stopped_matching} are matched no longer.`,
    ),
    h(
      "p",
      { class: "quiet" },
      `${count(totals.kept, "kept query", "kept queries")}, by small images, `,
      `and ${count(totals.views, "view")} of the map, each left out while it asks.`,
    ),
    h(
      "div",
      { class: "table", tabindex: "0", role: "region", "aria-label": "Totals" },
      table(["Figure", "Old recipe", "New recipe"], rows),
    ),
  );
}

function rowsSection(path, { queries }) {
  const different = queries.filter((one) => !one.agree);
  const alike = queries.length - different.length;
  return h(
    "section",
    { class: "panel" },
    h("h2", {}, different.length ? "Answered otherwise" : "No query is answered otherwise"),
    different.length > 0 &&
      h(
        "ul",
        { class: "matches shadow-rows" },
        different.map((one) => row(path, one)),
      ),
    alike > 0 && h("p", { class: "quiet" }, `${count(alike, "query", "queries")} answered alike`),
  );
}

function row(path, query) {
  const kept = query.source === "kept";
  const id = encodeURIComponent(query.id);
  const seen = kept ? `${path}/unknown/${id}/image` : `/views/${id}/thumbnail`;
  const title = kept ? "A query that was kept" : `A view of ${query.place ?? "a place without a name"}`;
  return h(
    "li",
    { class: "match" },
    h(
      "div",
      { class: "sides" },
      side(seen, title, "Query"),
      answerSide(query.old, "Old recipe"),
      answerSide(query.new, "New recipe"),
    ),
  );
}

function side(address, title, heading, ...more) {
  return h(
    "div",
    { class: "side" },
    h("h3", {}, heading),
    address && image(address, title, { width: 160, height: 120 }),
    h("span", {}, title),
    more,
  );
}

function answerSide(answer, heading) {
  const first = answer.place ?? (answer.view ? "A view without a place" : "Nothing");
  const address = answer.view && `/views/${encodeURIComponent(answer.view)}/thumbnail`;
  const right = answer.right === null ? null : answer.right ? "the right place" : "not its own place";
  return side(
    address,
    first,
    heading,
    h("span", {}, `${WORDS[answer.status]}, ${percent(answer.confidence)}`),
    right && h("span", { class: "quiet" }, right),
  );
}
