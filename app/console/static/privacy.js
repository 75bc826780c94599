// What a map does with photos: what is blurred before they are stored, and whether they are kept at all.

import { call } from "./api.js";
import { checkbox, confirmed, count, h, problemBox } from "./dom.js";

const GROUPS = [
  ["people", "People"],
  ["vehicles", "Vehicles"],
];

/** The section of a map, of which `latest()` gives the facts; `changed` is called after something was. */
export function photosSection(latest, path, changed) {
  const notice = h("div");
  const map = latest();
  const total = Object.values(map.views).reduce((sum, views) => sum + views, 0);

  async function patch(json, done) {
    try {
      await call("PATCH", path, { json, type: "application/merge-patch+json" });
      await changed(done);
    } catch (error) {
      notice.replaceChildren(problemBox(error));
    }
  }

  return h(
    "section",
    { class: "panel", "data-part": "photos" },
    h("h2", {}, "What becomes of photos"),
    notice,
    blurring(map, total, patch),
    keeping(map, total, () => latest().views.ready ?? 0, patch),
  );
}

function blurring(map, total, patch) {
  const boxes = GROUPS.map(([word, text]) => ({
    word,
    // With views there, less can be blurred from now on, not more: their images show it.
    ...checkbox(text, { checked: map.blur.includes(word), disabled: total > 0 && !map.blur.includes(word) }),
  }));
  const others = map.blur.filter((word) => !GROUPS.some(([group]) => group === word));
  const wanted = () => [...boxes.filter((one) => one.box.checked).map((one) => one.word), ...others];
  const changed = async (event) => {
    event.preventDefault();
    const blur = wanted();
    const fewer = map.blur.filter((word) => !blur.includes(word));
    const lost = fewer.join(" and ");
    const text = `Images enrolled from now on show ${lost}. While the map has views, this cannot be switched on again.`;
    if (total > 0 && fewer.length && !(await confirmed({ title: "Blur less?", text, action: "Blur less" }))) return;
    await patch({ blur }, blur.length ? `Blurred before storing: ${blur.join(", ")}.` : "Nothing is blurred.");
  };
  return h(
    "form",
    { class: "spaced", onsubmit: changed },
    h(
      "fieldset",
      {},
      h("legend", {}, "Blurred before a photo is stored"),
      h(
        "div",
        { class: "row" },
        boxes.map((one) => one.label),
      ),
      others.length > 0 && h("p", {}, `And ${others.join(", ")}.`),
      h(
        "p",
        { class: "quiet" },
        "As far as the service finds them, so look at the views. ",
        total > 0
          ? "The map has views: what is not blurred in these cannot be blurred in later ones. A new map can."
          : "To be chosen before the first photo.",
      ),
      h("button", { type: "submit", disabled: total > 0 && map.blur.length === 0 }, "Change what is blurred"),
    ),
  );
}

function keeping(map, total, ready, patch) {
  const remove = async () => {
    const described = ready();
    const text =
      `${described ? `The images of ${count(described, "view")} are deleted now, ` : "Each image is deleted "}` +
      `${described ? "and each later one " : ""}once its view is described. They cannot be shown again, described by ` +
      "another recipe or compared with later photos. This cannot be undone.";
    const typed = described ? map.name : null;
    if (await confirmed({ title: `Keep no images of ${map.name}?`, text, action: "Keep no images", typed }))
      await patch({ keep_images: false }, "Images are removed once they are described.");
  };
  const text = map.keep_images
    ? "Images are kept: they are shown, drawn over, and described anew by another recipe."
    : "Images are removed once their view is described. Places are recognised as before.";
  return h(
    "div",
    {},
    h("h3", {}, map.keep_images ? "Images are kept" : "Images are not kept"),
    h(
      "p",
      {},
      text,
      " ",
      !map.keep_images && total > 0 ? "Those of the views are gone; a new map can keep them." : "",
    ),
    map.keep_images
      ? h("button", { type: "button", class: "danger", onclick: remove }, "Keep no images …")
      : h(
          "button",
          {
            type: "button",
            disabled: total > 0,
            onclick: () => patch({ keep_images: true }, "Images are kept."),
          },
          "Keep images",
        ),
  );
}
