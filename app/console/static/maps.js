// Maps: all of them, and new ones.

import { call } from "./api.js";
import { MAP_NAME, field, h, problemBox, size, table } from "./dom.js";
import { lookAgain } from "./jobs.js";
import { part } from "./parts.js";

export function mapsScreen() {
  const listed = part((maps) => maps.map(({ name, views, places, bytes }) => [name, views, places, bytes]), tableOf);
  const list = h("div", { class: "table", tabindex: "0", role: "region", "aria-label": "Maps" }, listed.element);
  const notice = h("div");
  let left = false;
  let stop = () => {};
  const inputs = {
    name: h("input", { required: true, ...MAP_NAME }),
    preset: h("input", { placeholder: "default", spellcheck: "false" }),
    labels: h("input", { placeholder: "building, tree, road, car" }),
    dynamic: h("input", { placeholder: "car" }),
  };

  async function load() {
    const { maps } = await call("GET", "/maps");
    const focused = list.contains(document.activeElement) && document.activeElement.getAttribute("href");
    listed.show(maps);
    if (focused) list.querySelector(`a[href="${CSS.escape(focused)}"]`)?.focus();
  }

  async function made(event) {
    event.preventDefault();
    const named = (input) =>
      input.value
        .split(",")
        .map((one) => one.trim())
        .filter(Boolean);
    const list = (input) => (input.value.trim() ? named(input) : null);
    const wanted = {
      labels: list(inputs.labels),
      dynamic: list(inputs.dynamic),
      preset: inputs.preset.value.trim() || null,
    };
    const given = Object.fromEntries(Object.entries(wanted).filter(([, value]) => value !== null));
    try {
      const facts = await call("PUT", `/maps/${encodeURIComponent(inputs.name.value.trim())}`, { json: given });
      location.hash = `#maps/${encodeURIComponent(facts.name)}`;
    } catch (error) {
      notice.replaceChildren(problemBox(error));
    }
  }

  return {
    element: h(
      "div",
      {},
      h("h1", {}, "Maps"),
      h("section", { class: "panel" }, list),
      h("p", {}, h("a", { class: "button", href: "#snapshots" }, "Snapshots: maps as files")),
      h(
        "section",
        { class: "panel" },
        h(
          "details",
          {},
          h("summary", {}, "New map"),
          h("p", {}, "Enrolling makes a map too. Make one here to choose its labels first."),
          notice,
          h(
            "form",
            { onsubmit: made },
            h(
              "div",
              { class: "fields" },
              field("Name", inputs.name),
              field("Preset", inputs.preset),
              field("Labels, with commas", inputs.labels, true),
              field("Those that move", inputs.dynamic, true),
            ),
            h("button", { type: "submit", class: "first" }, "Make the map"),
          ),
        ),
      ),
    ),
    enter: async () => {
      await load();
      if (!left) stop = lookAgain(load, (error) => list.before(problemBox(error)));
    },
    leave: () => {
      left = true;
      stop();
    },
  };
}

function tableOf(maps) {
  if (maps.length) return table(["Map", "Views", "Places", "Size"], maps.map(row));
  const start = h("a", { href: "#enrol" }, "Enrol some photos");
  return h("p", {}, "Nothing is enrolled yet. ", start, " to make the first map.");
}

function row(map) {
  const { ready = 0, pending = 0, failed = 0 } = map.views;
  return [
    h("a", { href: `#maps/${encodeURIComponent(map.name)}` }, map.name),
    [
      ready.toLocaleString("en-GB"),
      pending > 0 && h("span", { class: "quiet" }, `, ${pending} pending`),
      failed > 0 && h("span", { class: "refused" }, `, ${failed} failed`),
    ],
    map.places.toLocaleString("en-GB"),
    size(map.bytes),
  ];
}
