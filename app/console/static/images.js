// Images of views: they need the key, so they are fetched with it and shown from memory.

import { send } from "./api.js";
import { h } from "./dom.js";

const AT_ONCE = 6;
const KEPT = 400;
const TRIES = 4;

/** Shown in place of an image that was removed. */
export const NOT_KEPT = "image not kept";

/** Shown in place of an image of a format that the browser does not know, as most do not know HEIC and TIFF. */
export const NOT_SHOWN = "this browser cannot show it";

const kept = new Map(); // path -> promise of a blob's URL, least recently shown first
const waiting = [];
let running = 0;

window.addEventListener("key", forgetImages);

/** Forget what was fetched: another key may not see it. */
export function forgetImages() {
  for (const url of kept.values()) url.then(URL.revokeObjectURL, () => {});
  kept.clear();
}

/** The URL of an image's bytes, fetched once. It is not fetched where `wanted()` is false when its turn comes. */
export function imageUrl(path, wanted = () => true) {
  let url = kept.get(path);
  if (url) {
    kept.delete(path);
    waiting.find((one) => one.path === path)?.wanted.push(wanted);
  } else {
    url = new Promise((resolve, reject) => waiting.push({ path, wanted: [wanted], resolve, reject }));
    url.catch(() => kept.get(path) === url && kept.delete(path));
    next();
  }
  kept.set(path, url);
  if (kept.size > KEPT) {
    const [oldest, old] = kept.entries().next().value;
    kept.delete(oldest);
    old.then(URL.revokeObjectURL, () => {});
  }
  return url;
}

async function next() {
  if (running >= AT_ONCE || !waiting.length) return;
  const { path, wanted, resolve, reject } = waiting.pop(); // the newest: where somebody looks now
  if (!wanted.some((one) => one())) {
    reject(new DOMException("scrolled away", "AbortError"));
    next();
    return;
  }
  running += 1;
  try {
    resolve(URL.createObjectURL(await fetched(path)));
  } catch (error) {
    reject(error);
  } finally {
    running -= 1;
    next();
  }
}

/** The bytes; a service that is busy is asked again when it says. */
async function fetched(path) {
  for (let tried = 1; ; tried += 1) {
    try {
      return await (await send("GET", path)).blob();
    } catch (error) {
      if (![429, 503].includes(error.status) || tried === TRIES) throw error;
      await new Promise((resolve) => setTimeout(resolve, (error.retryAfter ?? 2) * 1000));
    }
  }
}

/** An image element that loads once it is near the screen; until then it is not shown as one that is broken. */
export function image(path, alt, attributes = {}) {
  const element = h("img", { alt, decoding: "async", class: "awaited", ...attributes });
  nearby.observe(element);
  paths.set(element, path);
  return element;
}

/** The thumbnail of a view, or `NOT_KEPT` in its place where the map keeps no images. */
export function thumbnail(view, map, side, attributes = {}) {
  if (!map.keep_images) return h("span", { class: "quiet" }, NOT_KEPT);
  return image(`${view.links.thumbnail}?size=${side}`, "", attributes);
}

const paths = new WeakMap();
const nearby = new IntersectionObserver(
  (entries) => {
    for (const { target, isIntersecting } of entries) {
      if (!isIntersecting) continue;
      nearby.unobserve(target);
      imageUrl(paths.get(target), () => target.isConnected).then(
        (url) => {
          target.src = url;
          target.classList.remove("awaited");
        },
        (error) => {
          // What was taken from the page may come back with its screen.
          if (error.name === "AbortError") return nearby.observe(target);
          target.alt += ` (not shown: ${error.detail ?? error.message})`;
          target.classList.remove("awaited");
        },
      );
    }
  },
  { rootMargin: "200px" },
);

/** A figure for a drawing that takes a moment: says so, and says what went wrong instead of it. */
export function drawing(path, alt, caption) {
  const figure = h("figure", { class: "frame missing" }, "drawing …");
  imageUrl(path).then(
    (url) => {
      figure.classList.remove("missing");
      const shown = h("img", { src: url, alt, onerror: () => shown.replaceWith(`${alt}: ${NOT_SHOWN}`) });
      figure.replaceChildren(
        h("a", { href: url, target: "_blank", "aria-label": `${alt}, in a new tab` }, shown),
        h("figcaption", {}, caption),
      );
    },
    (error) => {
      figure.textContent = `${alt}: ${error.detail ?? error.message}`;
    },
  );
  return figure;
}
