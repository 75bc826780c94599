// What every screen of a map begins with, and parts of screens that are drawn anew.

import { h } from "./dom.js";

const PARTS = [
  ["", "Views"],
  ["health", "Health"],
  ["inbox", "Inbox"],
  ["recipe", "Recipe"],
];

/** The name of a map, and links to its parts; `current` is the one that is shown. */
export function mapHead(name, current = "") {
  const address = (part) => `#maps/${encodeURIComponent(name)}${part && `/${part}`}`;
  const links = PARTS.map(([part, title]) =>
    h("a", { href: address(part), "aria-current": part === current ? "page" : null }, title),
  );
  links.push(h("a", { href: "#snapshots" }, "Snapshots"));
  return [
    h("p", {}, h("a", { href: "#maps" }, "All maps")),
    h("h1", {}, name),
    h("nav", { class: "parts-of-map", "aria-label": "Parts of this map" }, links),
  ];
}

/**
 * A part of a screen that `make(map)` draws. It is drawn anew only when `basisOf(map)`, what it shows, has changed, so
 * that what is unfolded or typed there stays. Gives {element, show(map)}.
 */
export function part(basisOf, make) {
  const element = h("div");
  let shown = null;
  function show(map) {
    const now = JSON.stringify(basisOf(map));
    if (now === shown) return;
    shown = now;
    element.replaceChildren(make(map));
  }
  return { element, show };
}
