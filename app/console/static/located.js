// The plan of a map: the positions of its views, read page by page, and read on where views are added.

import { pages } from "./api.js";
import { h, problemBox } from "./dom.js";
import { plan, pointOf } from "./plan.js";

const PAGE = 500;
const AT_FIRST = 20_000;

/**
 * A panel with the plan of a map; `chosen(id)` is called for the view that is picked.
 * Gives {element, show(map), put(id, view)}. Call `show` with the facts of the map whenever they may have changed, and
 * `put` with a view that was edited here, or with null for one that was deleted.
 */
export function located(name, chosen) {
  const points = new Map(); // id -> point, or null for a view without a position
  const picture = plan([], { picked: (point) => chosen(point.id) });
  const counts = h("p", { class: "quiet" });
  const more = h("button", { type: "button", onclick: readAll, hidden: true }, "Show all");
  const wrong = h("div");
  const element = h(
    "section",
    { class: "panel", hidden: true },
    h("h2", {}, "Plan"),
    picture.element,
    counts,
    more,
    wrong,
  );
  let list = null;
  let most = AT_FIRST;
  let total = 0;
  let reading = false;
  let again = false; // whether the map changed while it was being read

  function show(map) {
    element.hidden = !map.extent;
    const number = Object.values(map.views).reduce((sum, views) => sum + views, 0);
    if (element.hidden) return;
    if (!list || number < total)
      begin(); // views were deleted elsewhere, and it is not known which
    else list.resume();
    total = number;
    read();
  }

  function begin() {
    points.clear();
    list = pages("/views", { map: name, limit: PAGE });
  }

  async function read() {
    again = reading;
    if (reading) return;
    reading = true;
    wrong.replaceChildren();
    try {
      do {
        again = false;
        await readOn();
      } while (again);
    } catch (error) {
      wrong.replaceChildren(problemBox(error), h("button", { type: "button", onclick: read }, "Try again"));
    } finally {
      reading = false;
      showCounts();
    }
  }

  async function readOn() {
    while (points.size < most) {
      const mine = list;
      const { value, done } = await mine.next();
      if (done || !element.isConnected) break;
      if (mine !== list) continue; // begun anew
      for (const view of value.views) points.set(view.id, view.position && pointOf(view));
      picture.show(here());
      showCounts();
    }
  }

  const here = () => [...points.values()].filter(Boolean);

  function showCounts() {
    const [read, all] = [points.size, total].map((number) => number.toLocaleString("en-GB"));
    const some = points.size < total && (reading || points.size >= most);
    counts.textContent = some ? `It shows the first ${read} of ${all} views${reading ? " …" : "."}` : "";
    more.hidden = !some || reading;
  }

  function readAll() {
    most = Infinity;
    more.hidden = true;
    read();
  }

  function put(id, view) {
    if (view) points.set(id, view.position && pointOf(view));
    else if (points.delete(id)) total -= 1;
    picture.show(here());
  }

  return { element, show, put };
}
