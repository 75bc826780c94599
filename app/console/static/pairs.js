// The query and a view side by side, joined where they agree. Hovering or choosing a region shows its label.

import { checkbox, decimals, h, svg } from "./dom.js";
import { imageUrl, NOT_SHOWN } from "./images.js";

const HEIGHT = 1000; // of both photos in the drawing's own units
const GAP = 24;

/** Both photos in one drawing. Positions are fractions of a photo's longer side, as the API has them. */
class SideBySide {
  constructor(label, query, photo, view) {
    const left = {
      width: (HEIGHT * query.width) / query.height,
      unit: Math.max(query.width, query.height) * (HEIGHT / query.height),
      x: 0,
    };
    const { width, height } = view.image;
    const right = {
      width: (HEIGHT * width) / height,
      unit: Math.max(width, height) * (HEIGHT / height),
      x: left.width + GAP,
    };
    this.left = ([x, y]) => [x * left.unit, y * left.unit];
    this.right = ([x, y]) => [right.x + x * right.unit, y * right.unit];
    this.unit = left.unit;
    const theirs = svg("image", { x: right.x, y: 0, width: right.width, height: HEIGHT });
    // No larger than it is drawn, and JPEG whatever was enrolled.
    imageUrl(`${view.links.thumbnail}?size=1024`).then(
      (url) => theirs.setAttribute("href", url),
      () => {},
    );
    const ours = svg("image", { x: 0, y: 0, width: left.width, height: HEIGHT, href: photo, onerror });
    function onerror() {
      ours.replaceWith(svg("text", { x: left.width / 2, y: HEIGHT / 2, class: "not-shown" }, NOT_SHOWN));
    }
    this.element = svg(
      "svg",
      { class: "pairs", viewBox: `0 0 ${right.x + right.width} ${HEIGHT}`, role: "img", "aria-label": label },
      ours,
      theirs,
    );
  }

  link(from, to, attributes) {
    const [[x1, y1], [x2, y2]] = [this.left(from), this.right(to)];
    return svg("line", { x1, y1, x2, y2, ...attributes });
  }
}

/** Regions of the graphs and keypoints that correspond; without `explain` only the photos are shown. */
export function pairs(query, match, photo) {
  const nodes = match.graph?.pairs ?? [];
  const keypoints = match.verification?.pairs ?? [];
  const both = new SideBySide(
    `Your photo beside match ${match.rank}: ${nodes.length} regions and ${keypoints.length} keypoints agree`,
    query,
    photo,
    match.view,
  );
  const layer = svg(
    "g",
    {},
    keypoints.map(([from, to]) => both.link(from, to, { class: "keypoint" })),
  );
  const hovered = h("p", { class: "quiet" }, nodes.length ? "Point at a region to see its label and similarity." : "");
  const drawn = nodes.map((pair, index) => {
    const [[x1, y1], [x2, y2]] = [both.left(pair.query), both.right(pair.view)];
    const on = { onmouseenter: () => light(index), onmouseleave: () => light(null) };
    return [
      both.link(pair.query, pair.view, { class: "link", ...on }),
      svg("circle", { cx: x1, cy: y1, r: 15, class: "point", ...on }),
      svg("circle", { cx: x2, cy: y2, r: 15, class: "point", ...on }),
    ];
  });
  const chips = nodes.map((pair, index) =>
    h(
      "li",
      {},
      h(
        "button",
        {
          type: "button",
          onmouseenter: () => light(index),
          onmouseleave: () => light(null),
          onfocus: () => light(index),
          onblur: () => light(null),
        },
        `${pair.label} ${decimals(pair.cosine)}`,
      ),
    ),
  );
  function light(chosen) {
    drawn.forEach((group, index) =>
      group.forEach((shape) => {
        shape.classList.toggle("lit", index === chosen);
        shape.classList.toggle("dim", chosen !== null && index !== chosen);
      }),
    );
    if (chosen !== null) hovered.textContent = `${nodes[chosen].label}: similarity ${decimals(nodes[chosen].cosine)}`;
  }
  both.element.append(layer, ...drawn.flat());
  const shown = checkbox(`Keypoints (${keypoints.length})`, {
    checked: true,
    onchange: () => {
      layer.style.display = shown.box.checked ? "" : "none";
    },
  });
  return h(
    "div",
    {},
    both.element,
    keypoints.length > 0 && shown.label,
    hovered,
    chips.length > 0 && h("ul", { class: "chips", "aria-label": "Regions that agree" }, chips),
  );
}

/** The regions of the query that speak for the first match (green) or for its rival (orange). */
export function differences(query, rival, photo) {
  const regions = rival.differs ?? [];
  const both = new SideBySide("Your photo beside the rival", query, photo, rival.view);
  for (const { centre, extent, strength } of regions) {
    const [x, y] = both.left([centre[0] - extent[0] / 2, centre[1] - extent[1] / 2]);
    both.element.append(
      svg("rect", {
        x,
        y,
        width: extent[0] * both.unit,
        height: extent[1] * both.unit,
        class: strength > 0 ? "for" : "against",
      }),
    );
  }
  return h(
    "div",
    {},
    both.element,
    h(
      "p",
      { class: "quiet" },
      regions.length
        ? "Framed: where the two differ most; green speaks for the first, orange for the rival."
        : "Where they differ is told when “Draw what agrees” is on.",
    ),
  );
}
