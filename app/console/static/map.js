// One map: where its views lie, its places, thumbnails, words, jobs, and what its verdicts rest on.

import { call } from "./api.js";
import { browser } from "./browser.js";
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
  screenProblem,
  size,
} from "./dom.js";
import { jobList, lookAgain } from "./jobs.js";
import { mapHead, part } from "./parts.js";
import { photosSection } from "./privacy.js";
import { showReceipt } from "./receipt.js";

export function mapScreen(name) {
  const path = `/maps/${encodeURIComponent(name)}`;
  const element = h("div", {}, h("p", {}, "Loading …"));
  const wrong = h("div");
  let left = false;
  let loads = 0;
  let stop = () => {};
  let jobs = null;
  let sections = null; // once the map is there
  let map = null;

  async function load() {
    const mine = ++loads;
    const facts = await call("GET", path);
    if (left || mine !== loads) return; // what was asked for later is newer
    map = facts;
    chooseMap(name);
    if (!sections) draw();
    for (const one of sections) one.show(map);
    wrong.replaceChildren();
  }

  function draw() {
    jobs = jobList(name, reload);
    sections = [about(), browser(name, reload), decisions(), words(), photos()];
    const [first, views, ...others] = sections.map((one) => one.element);
    const background = h("section", { class: "panel" }, jobs.element);
    element.replaceChildren(...mapHead(name), wrong, first, views, background, ...others, removal());
  }

  const told = (error) => wrong.replaceChildren(problemBox(error));
  const reload = () => load().catch(told);

  /** Others may have changed the map, and begun jobs of it. */
  async function look() {
    const before = JSON.stringify(map);
    await load();
    if (JSON.stringify(map) !== before) jobs.look();
  }

  function about() {
    const shown = part(
      ({ views, places, bytes, created_at, revision }) => [views, places, bytes, created_at, revision],
      (map) => {
        const { ready = 0, pending = 0, failed = 0 } = map.views;
        const states = [
          count(ready, "view") + " ready",
          pending && `${pending} pending`,
          failed && `${failed} failed`,
        ];
        return facts([
          ["Views", states.filter(Boolean).join(", ")],
          ["Places", count(map.places, "place")],
          ["Images", size(map.bytes)],
          ["Made", moment(map.created_at)],
          ["Revision", map.revision],
        ]);
      },
    );
    const links = h(
      "div",
      { class: "row" },
      h("a", { class: "button", href: "#ask" }, "Ask this map"),
      h("a", { class: "button", href: "#enrol" }, "Enrol more"),
    );
    return { element: h("section", { class: "panel" }, shown.element, links), show: shown.show };
  }

  function decisions() {
    const notice = h("div");
    const precision = h("input", { type: "number", min: 0.5, max: 0.999, step: 0.001 });
    let asked = null; // the precision of the map that the input was filled with
    const shown = part(
      (map) => map.decision,
      ({ decision }) => {
        const { expected } = decision;
        const precise = expected.precision === null ? "an unknown share" : percent(expected.precision);
        return facts([
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
            `${precise} of sure answers are right; ${percent(expected.matched_share)} of right answers are sure`,
          ],
          ["Updated", moment(decision.updated_at)],
        ]);
      },
    );
    async function changed(event) {
      event.preventDefault();
      try {
        await call("PATCH", path, {
          json: { ranking: { precision: Number(precision.value) } },
          type: "application/merge-patch+json",
        });
        notice.replaceChildren();
        announce("changed");
        await load();
      } catch (error) {
        notice.replaceChildren(problemBox(error));
      }
    }
    const element = h(
      "section",
      { class: "panel" },
      h("h2", {}, "What its verdicts rest on"),
      shown.element,
      notice,
      h(
        "form",
        { class: "row", onsubmit: changed },
        field("Share of sure answers that must be right", precision),
        h("button", { type: "submit" }, "Change"),
      ),
    );
    function show(map) {
      shown.show(map);
      const wanted = String(map.ranking.precision ?? 0.97);
      if (wanted !== asked) precision.value = asked = wanted;
    }
    return { element, show };
  }

  const words = () =>
    part(({ labels, vocabulary, recipe, ranking }) => [labels, vocabulary, recipe, ranking], vocabulary);

  function vocabulary(map) {
    const notice = h("div");
    const train = h(
      "button",
      {
        type: "button",
        onclick: async () => {
          try {
            await call("POST", `${path}/vocabulary`);
            jobs.look();
          } catch (error) {
            notice.replaceChildren(problemBox(error));
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
      notice,
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

  const photos = () =>
    part(
      (map) => [map.blur, map.keep_images, Object.values(map.views).some((number) => number > 0)],
      () =>
        photosSection(
          () => map,
          path,
          async (done) => {
            await load();
            announce(done);
          },
        ),
    );

  function leave() {
    left = true;
    stop();
    jobs?.stop();
  }

  function removal() {
    const notice = h("div");
    return h(
      "section",
      { class: "panel" },
      h("h2", {}, "Delete"),
      notice,
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
            stop(); // what is deleted cannot be looked at again, however long the receipt is read
            try {
              const receipt = await call("DELETE", path);
              leave();
              await showReceipt(`The map ${name} is deleted`, receipt);
              location.hash = "#maps";
            } catch (error) {
              if (!left) stop = lookAgain(look, told);
              notice.replaceChildren(problemBox(error));
            }
          },
        },
        "Delete this map …",
      ),
    );
  }

  return {
    element,
    enter: async () => {
      try {
        await load();
        if (!left) stop = lookAgain(look, told);
      } catch (error) {
        if (error.status === 401) throw error; // the dialog is open
        element.replaceChildren(...mapHead(name), screenProblem(error));
      }
    },
    leave,
  };
}
