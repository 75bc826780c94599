// The views of a map: its plan, thumbnails of all or of one place, and the names of its places.

import { call, pages } from "./api.js";
import { announce, count, field, h, problemBox } from "./dom.js";
import { located } from "./located.js";
import { openView } from "./view.js";
import { Views, grid } from "./views.js";

const PLACES_A_PAGE = 100;

/**
 * What is in a map. `changed()` is called after a view was edited or deleted; it promises that the map's facts are
 * shown anew. Gives {element, show(map)}; call `show` whenever the map may have changed. The place that is chosen and
 * what is in sight stay.
 */
export function browser(name, changed) {
  let map = null;
  let place = null; // whose views are shown; null: all
  let edits = 0; // number of views that were edited or deleted here
  let shown = ""; // the state of the map that is shown
  const notice = h("div");
  const heading = h("h2", {}, "All views");
  const newest = h(
    "select",
    { onchange: () => list() },
    h("option", { value: "enrolled_at" }, "oldest first"),
    h("option", { value: "-enrolled_at" }, "newest first"),
  );
  const planned = located(name, picked);
  const thumbnails = grid(open);
  const names = placeNames(name, choose);
  const none = h("p", {}, "Nothing is enrolled here yet. ", h("a", { href: "#enrol" }, "Enrol some photos"), ".");
  const places = h("section", { class: "panel" }, h("h2", {}, "Places"), names.element);
  const total = () => Object.values(map.views).reduce((sum, views) => sum + views, 0);

  function show(facts) {
    const drawn = map !== null && total() > 0;
    map = facts;
    const { revision, views, extent, keep_images: kept } = map;
    const now = JSON.stringify([revision, views, map.places, extent, kept, edits]);
    if (now === shown) return;
    shown = now;
    none.hidden = total() > 0;
    thumbnails.element.hidden = total() === 0;
    places.hidden = map.places === 0;
    planned.show(map);
    if (map.places > 0) names.show();
    if (total() > 0) list(drawn);
  }

  function choose(chosen) {
    place = chosen;
    list();
  }

  async function list(stay = false) {
    const [mine, all] = [place, place === null];
    heading.textContent = all ? "All views" : place;
    const views = new Views({ map: name, sort: newest.value, place });
    await thumbnails.show(views, map, all ? total() : 0, stay);
    // The last view of a place was renamed or deleted.
    if (mine === place && !all && views.complete && views.items.length === 0) names.choose(null);
  }

  async function picked(id) {
    notice.replaceChildren();
    try {
      open(await call("GET", `/views/${encodeURIComponent(id)}`));
    } catch (error) {
      if (error.status === 404) planned.put(id, null);
      notice.replaceChildren(problemBox(error));
    }
  }

  function open(view) {
    openView(view, map, async (after) => {
      planned.put(view.id, after);
      edits += 1;
      announce("done");
      await changed();
    });
  }

  return {
    element: h(
      "div",
      {},
      planned.element,
      notice,
      h(
        "div",
        { class: "columns" },
        h(
          "section",
          { class: "panel" },
          h("div", { class: "row between" }, heading, field("Order", newest)),
          none,
          thumbnails.element,
        ),
        places,
      ),
    ),
    show,
  };
}

/** The names of a map's places, a page at a time; `chosen(null)` shows all views again. */
function placeNames(map, chosen) {
  const list = h("ul", { class: "names" });
  const next = h("button", { type: "button", onclick: () => read(rows.length + 1) }, "More places");
  const wrong = h("div");
  let rows = [];
  let reading = null;
  let current = null;

  /** Read on until `number` places are there, or all. */
  async function read(number, from = reading, known = rows) {
    next.disabled = true;
    wrong.replaceChildren();
    try {
      let more = true;
      while (more && known.length < number) {
        const { value } = await from.next();
        known = [...known, ...(value?.places ?? [])];
        more = Boolean(value?.next);
      }
      [rows, reading] = [known, from];
      draw();
      next.hidden = !more;
    } catch (error) {
      wrong.replaceChildren(problemBox(error));
    } finally {
      next.disabled = false;
    }
  }

  function draw() {
    const focused = list.contains(document.activeElement) && document.activeElement.dataset.place;
    list.replaceChildren(...rows.map((one) => h("li", {}, button(one))));
    if (typeof focused === "string") list.querySelector(`[data-place="${CSS.escape(focused)}"]`)?.focus();
  }

  function button({ place, views }) {
    return h(
      "button",
      {
        type: "button",
        "aria-pressed": String(place === current),
        "data-place": place,
        onclick: () => choose(place === current ? null : place),
      },
      h("span", {}, place),
      h("span", { class: "quiet" }, count(views, "view")),
    );
  }

  function choose(place) {
    current = place;
    for (const one of list.querySelectorAll("button")) one.setAttribute("aria-pressed", one.dataset.place === current);
    chosen(place);
  }

  return {
    element: h("div", {}, list, next, wrong),
    choose,
    /** Show them anew, as many as there were. */
    show: () => read(Math.max(1, rows.length), pages("/places", { map, limit: PLACES_A_PAGE }), []),
  };
}
