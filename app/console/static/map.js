// One map: where its views lie, its places, thumbnails, words, jobs, and what its verdicts rest on.

import { call, pages } from "./api.js";
import { chooseMap } from "./choice.js";
import {
  announce,
  bars,
  confirmed,
  count,
  decimals,
  facts,
  field,
  folded,
  h,
  moment,
  percent,
  problemBox,
  size,
} from "./dom.js";
import { jobList } from "./jobs.js";
import { mapHead } from "./parts.js";
import { plan, pointOf } from "./plan.js";
import { photosSection } from "./privacy.js";
import { showReceipt } from "./receipt.js";
import { openView } from "./view.js";
import { Views, grid } from "./views.js";

const PLACES_A_PAGE = 100;
const MOST_ON_PLAN = 20_000;

export function mapScreen(name) {
  const path = `/maps/${encodeURIComponent(name)}`;
  const element = h("div", {}, h("p", {}, "Loading …"));
  let left = false;
  let jobs = null;

  async function load() {
    const map = await call("GET", path);
    if (left) return;
    chooseMap(name);
    jobs?.stop();
    jobs = jobList(name, reload);
    const { ready = 0, pending = 0, failed = 0 } = map.views;
    const total = ready + pending + failed;
    element.replaceChildren(
      ...mapHead(name),
      h(
        "section",
        { class: "panel" },
        facts([
          [
            "Views",
            [count(ready, "view") + " ready", pending && `${pending} pending`, failed && `${failed} failed`]
              .filter(Boolean)
              .join(", "),
          ],
          ["Places", count(map.places, "place")],
          ["Images", size(map.bytes)],
          ["Made", moment(map.created_at)],
          ["Revision", map.revision],
        ]),
        h(
          "div",
          { class: "row" },
          h("a", { class: "button", href: "#ask" }, "Ask this map"),
          h("a", { class: "button", href: "#enrol" }, "Enrol more"),
        ),
      ),
      browser(map, total),
      h("section", { class: "panel" }, jobs.element),
      decisions(map),
      words(map),
      photosSection(map, path, async (done) => {
        await load();
        announce(done);
      }),
      removal(),
    );
  }

  const reload = () => load().catch((error) => element.prepend(problemBox(error)));

  function browser(map, total) {
    const shown = h("div");
    let filled = false; // the plan, by the first reading of all views
    let chosen = null; // the place whose views are shown
    const heading = h("h2", {}, "All views");
    const newest = h(
      "select",
      { onchange: () => filter(chosen) },
      h("option", { value: "enrolled_at" }, "oldest first"),
      h("option", { value: "-enrolled_at" }, "newest first"),
    );
    const picture = plan([], { picked: (point) => open(point.view) });
    const planned = h("section", { class: "panel", hidden: !map.extent }, h("h2", {}, "Plan"), picture.element);
    if (total > MOST_ON_PLAN)
      planned.append(h("p", { class: "quiet" }, `It shows the first ${MOST_ON_PLAN.toLocaleString("en-GB")} views.`));
    const open = (view) =>
      openView(view, map, async () => {
        announce("done");
        await reload();
        element.querySelector(".grid")?.focus();
      });
    const names = placeNames(name, filter);

    function filter(place) {
      chosen = place;
      heading.textContent = place === null ? "All views" : place;
      const all = place === null;
      const fills = all && map.extent && !filled;
      filled ||= fills;
      const views = new Views({ map: name, sort: newest.value, place }, (more) => {
        if (fills) picture.add(more.filter((view) => view.position).map(pointOf));
      });
      const thumbnails = grid(views, map, all ? total : 0, open);
      shown.replaceChildren(thumbnails.element);
      thumbnails.read(fills ? MOST_ON_PLAN : 1);
      thumbnails.draw();
    }
    if (total) filter(null);
    return h(
      "div",
      {},
      planned,
      h(
        "div",
        { class: "columns" },
        h(
          "section",
          { class: "panel" },
          h("div", { class: "row between" }, heading, field("Order", newest)),
          total
            ? shown
            : h("p", {}, "Nothing is enrolled here yet. ", h("a", { href: "#enrol" }, "Enrol some photos"), "."),
        ),
        map.places > 0 && h("section", { class: "panel" }, h("h2", {}, "Places"), names),
      ),
    );
  }

  function decisions(map) {
    const { decision } = map;
    const precise = decision.expected.precision === null ? "an unknown share" : percent(decision.expected.precision);
    const told = h("div");
    const precision = h("input", {
      type: "number",
      min: 0.5,
      max: 0.999,
      step: 0.001,
      value: String(map.ranking.precision ?? 0.97),
    });
    async function changed(event) {
      event.preventDefault();
      try {
        await call("PATCH", path, {
          json: { ranking: { precision: Number(precision.value) } },
          type: "application/merge-patch+json",
        });
        announce("changed");
        await load();
      } catch (error) {
        told.replaceChildren(problemBox(error));
      }
    }
    return h(
      "section",
      { class: "panel" },
      h("h2", {}, "What its verdicts rest on"),
      facts([
        [
          "Measured",
          {
            cohort: "mostly in other maps, while few views are compared",
            "own-views": "mostly in this map",
            calibration: "with labelled queries of this map",
          }[decision.source],
        ],
        ["Views compared", decision.views_compared.toLocaleString("en-GB")],
        [
          "Expected",
          `${precise} of sure answers are right; ${percent(decision.expected.matched_share)} of right answers are sure`,
        ],
        ["Updated", moment(decision.updated_at)],
      ]),
      told,
      h(
        "form",
        { class: "row", onsubmit: changed },
        field("Share of sure answers that must be right", precision),
        h("button", { type: "submit" }, "Change"),
      ),
    );
  }

  function words(map) {
    const told = h("div");
    const train = h(
      "button",
      {
        type: "button",
        onclick: async () => {
          try {
            await call("POST", `${path}/vocabulary`);
            await load();
          } catch (error) {
            told.replaceChildren(problemBox(error));
          }
        },
      },
      "Train a vocabulary on these views",
    );
    const plain = Object.entries(map.vocabulary).filter(([, value]) => value === null || typeof value !== "object");
    return h(
      "section",
      { class: "panel" },
      h("h2", {}, "Labels and vocabulary"),
      h(
        "ul",
        { class: "chips" },
        map.labels.map((label) => {
          const swatch = h("span", { class: "swatch", style: { background: label.colour }, "aria-hidden": "true" });
          return h(
            "li",
            {},
            swatch,
            label.label,
            label.dynamic && h("span", { class: "quiet" }, " (moves)"),
            !label.trained && h("span", { class: "quiet" }, " (by its words)"),
          );
        }),
      ),
      shares(map),
      facts(
        plain.map(([key, value]) => [
          key,
          typeof value === "number" && !Number.isInteger(value) ? decimals(value, 3) : String(value),
        ]),
      ),
      h(
        "details",
        {},
        h("summary", {}, "Recipe and ranking"),
        h("pre", { tabindex: "0" }, JSON.stringify({ recipe: map.recipe, ranking: map.ranking }, null, 1)),
      ),
      told,
      train,
    );
  }

  /** How much of all views each label covers, read once it is unfolded. */
  function shares(map) {
    const body = h("div");
    async function read() {
      const dynamic = map.labels.map((label) => label.label).join(",");
      try {
        const { labels } = await call("GET", `${path}/dynamic`, { query: { dynamic, limit: 1 } });
        const seen = labels.filter((one) => one.views).sort((one, other) => other.share - one.share);
        body.replaceChildren(
          seen.length ? bars(seen.map((one) => [one.label, one.share])) : "No view is described yet.",
        );
      } catch (error) {
        body.replaceChildren(problemBox(error));
      }
    }
    return folded("How much of the views each label covers", () => {
      read();
      return body;
    });
  }

  function removal() {
    const told = h("div");
    return h(
      "section",
      { class: "panel" },
      h("h2", {}, "Delete"),
      told,
      h(
        "button",
        {
          type: "button",
          class: "danger",
          onclick: async () => {
            if (
              !(await confirmed({
                title: `Delete the map ${name}?`,
                text: "All its views and their images are deleted. This cannot be undone.",
                action: "Delete the map",
                typed: name,
              }))
            )
              return;
            try {
              await showReceipt(`The map ${name} is deleted`, await call("DELETE", path));
              location.hash = "#maps";
            } catch (error) {
              told.replaceChildren(problemBox(error));
            }
          },
        },
        "Delete this map …",
      ),
    );
  }

  return {
    element,
    enter: () =>
      load().catch((error) => {
        if (error.status === 401) throw error; // the dialog is open
        element.replaceChildren(...mapHead(name), problemBox(error));
      }),
    leave: () => {
      left = true;
      jobs?.stop();
    },
  };
}

/** The names of a map's places, a page at a time; `chosen(null)` shows all views again. */
function placeNames(map, chosen) {
  const list = h("ul", { class: "names" });
  const next = h("button", { type: "button", onclick: () => more() }, "More places");
  const reading = pages("/places", { map, limit: PLACES_A_PAGE });
  function choose(button, name) {
    const on = button.getAttribute("aria-pressed") !== "true";
    for (const other of list.querySelectorAll("button")) other.setAttribute("aria-pressed", "false");
    button.setAttribute("aria-pressed", on);
    chosen(on ? name : null);
  }
  async function more() {
    next.disabled = true;
    try {
      const { value } = await reading.next();
      next.hidden = !value?.next;
      list.append(
        ...(value?.places ?? []).map((one) => {
          const button = h(
            "button",
            { type: "button", "aria-pressed": "false", onclick: () => choose(button, one.place) },
            h("span", {}, one.place),
            h("span", { class: "quiet" }, count(one.views, "view")),
          );
          return h("li", {}, button);
        }),
      );
    } catch (error) {
      list.after(problemBox(error));
    } finally {
      next.disabled = false;
    }
  }
  more();
  return h("div", {}, list, next);
}
