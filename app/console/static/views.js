// The views of a map: fetched page by page, shown as thumbnails of which only those in sight exist.

import { pages } from "./api.js";
import { h, place as inWords, problemBox } from "./dom.js";
import { thumbnail } from "./images.js";

const PAGE = 500;
const SMALLEST_PX = 128;
const BEYOND = 2; // rows above and below what is in sight

/** A list of views that grows by pages as far as somebody looks. */
export class Views {
  constructor(query) {
    this.items = [];
    this.complete = false;
    this._pages = pages("/views", { limit: PAGE, ...query });
    this._reading = null;
  }

  /** Read on until `number` views are there, or all. */
  async upTo(number) {
    while (!this.complete && this.items.length < number) {
      this._reading ??= this._next();
      await this._reading;
    }
  }

  async _next() {
    try {
      const { value, done } = await this._pages.next();
      if (done) this.complete = true;
      else {
        this.items.push(...value.views);
        this.complete = !value.next;
      }
    } finally {
      this._reading = null;
    }
  }
}

/**
 * A grid of thumbnails that scrolls through any number of views; `chosen(view)` is called for one.
 * Gives {element, show}; see there.
 */
export function grid(chosen) {
  const track = h("div", { class: "track", role: "list" });
  const element = h(
    "div",
    { class: "grid", tabindex: "0", role: "region", "aria-label": "Thumbnails of views" },
    track,
  );
  const cells = new Map(); // index -> element
  const notice = h("div");
  let views = null;
  let map = null;
  let total = 0;
  let latest = null; // the list that is to be shown
  let broken = false; // a page did not come: somebody has to ask for it again

  const length = () => (views.complete ? views.items.length : Math.max(total, views.items.length));

  /**
   * Show a list of views; resolves once some are there.
   * of: the map whose they are; number: how many there are by the map's counts, so that the bar is as long from the
   * start; stay: keep what is in sight, and the button that has the focus, where the same views are listed anew.
   */
  async function show(list, of, number, stay = false) {
    latest = list;
    mended();
    const least = stay && views ? views.items.length : 1;
    if (!stay) {
      put(list, of, number);
      element.scrollTop = 0;
    }
    await read(list, least, () => show(list, of, number, stay));
    if (stay && latest === list && !broken) put(list, of, number);
  }

  function put(list, of, number) {
    const before = views?.items ?? [];
    const focused = [...cells].find(([, cell]) => cell.contains(document.activeElement))?.[0];
    for (const [index, cell] of cells) {
      if (of.keep_images === map.keep_images && JSON.stringify(before[index]) === JSON.stringify(list.items[index]))
        continue;
      cell.remove();
      cells.delete(index);
    }
    [views, map, total] = [list, of, number];
    draw();
    if (focused !== undefined && !element.contains(document.activeElement))
      (cells.get(focused)?.querySelector("button") ?? element).focus({ preventScroll: true });
  }

  function draw() {
    const width = element.clientWidth;
    if (!width || !views) return;
    const columns = Math.max(2, Math.floor(width / SMALLEST_PX));
    const side = width / columns;
    const height = side * 0.75;
    track.style.height = `${Math.ceil(length() / columns) * height}px`;
    const top = Math.max(0, Math.floor(element.scrollTop / height) - BEYOND) * columns;
    const bottom = (Math.ceil((element.scrollTop + element.clientHeight) / height) + BEYOND) * columns;
    for (const [index, cell] of cells) {
      if ((index < top || index >= bottom) && !cell.contains(document.activeElement)) {
        cell.remove();
        cells.delete(index);
      }
    }
    for (let index = top; index < Math.min(bottom, views.items.length); index += 1) {
      const cell = cells.get(index) ?? made(views.items[index], index);
      Object.assign(cell.style, {
        width: `${side}px`,
        height: `${height}px`,
        left: `${(index % columns) * side}px`,
        top: `${Math.floor(index / columns) * height}px`,
      });
      cell.setAttribute("aria-setsize", length());
    }
    if (bottom > views.items.length && !views.complete && !broken) read(views, bottom, () => draw());
  }

  /** Read a list on until `number` views are there, and draw them; what does not come is asked for by hand. */
  async function read(list, number, again) {
    try {
      await list.upTo(number);
      if (views === list) draw();
    } catch (error) {
      if (latest !== list) return;
      broken = true;
      const button = h("button", { type: "button", onclick: tryAgain }, "Try again");
      notice.replaceChildren(problemBox(error), button);
    }
    function tryAgain() {
      mended();
      element.focus();
      again();
    }
  }

  function mended() {
    broken = false;
    notice.replaceChildren();
  }

  function made(view, index) {
    const name = view.place ?? inWords(view.position) ?? view.id.slice(-6);
    const cell = h(
      "div",
      { class: "cell", role: "listitem", "aria-posinset": index + 1 },
      h(
        "button",
        { type: "button", "aria-label": `View ${index + 1}: ${name}`, onclick: () => chosen(view) },
        thumbnail(view, map, 256),
        h("span", { class: "caption" }, view.state === "ready" ? name : `${view.state}: ${name}`),
      ),
    );
    const after = [...cells.keys()].filter((other) => other > index).sort((a, b) => a - b)[0];
    track.insertBefore(cell, after === undefined ? null : cells.get(after));
    cells.set(index, cell);
    return cell;
  }

  let waiting = false;
  element.addEventListener("scroll", () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      draw();
    });
  });
  new ResizeObserver(draw).observe(element);
  return { element: h("div", {}, element, notice), show };
}
