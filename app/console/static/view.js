// One view: its image, what the service sees in it, its attributes, and deleting it.

import { call } from "./api.js";
import { changesSince } from "./changes.js";
import { bars, confirmed, facts, field, h, moment, place as inWords, problemBox, sentence, size } from "./dom.js";
import { NOT_KEPT, drawing } from "./images.js";
import { showReceipt } from "./receipt.js";

/** Open a dialog with a view; `changed` is called after it was edited, with what it is now, or deleted, with null. */
export function openView(view, map, changed) {
  const notice = h("div");
  const picture = h("div");
  let gone = false; // somebody else deleted it
  const kinds = [
    [
      "Photo",
      () =>
        drawing(
          view.links.image,
          `Photo of ${view.place ?? "a view"}`,
          `${view.image.width} × ${view.image.height}, ${size(view.image.bytes)}`,
        ),
    ],
    [
      "Labels",
      () =>
        drawing(`${view.links.segmentation}?overlay=true&legend=true`, "Labels of the view", "What moves is grey."),
    ],
    [
      "Graph",
      () =>
        drawing(`${view.links.graph}?legend=true`, "Context graph of the view", "Regions and which of them touch."),
    ],
  ];
  const choices = kinds.map(([name, make]) => {
    const button = h(
      "button",
      {
        type: "button",
        "aria-pressed": "false",
        onclick: () => {
          for (const other of choices) other.setAttribute("aria-pressed", other === button);
          picture.replaceChildren(make());
        },
      },
      name,
    );
    return button;
  });
  const dialog = h(
    "dialog",
    { "aria-labelledby": "view-title" },
    h(
      "div",
      { class: "row between" },
      h("h2", { id: "view-title" }, view.place ?? "A view without a name"),
      h("button", { type: "button", onclick: () => dialog.close() }, "Close"),
    ),
    h(
      "div",
      { class: "columns" },
      map.keep_images
        ? h("div", {}, h("div", { class: "row", role: "group", "aria-label": "Shown" }, choices), h("p"), picture)
        : h("p", { class: "frame missing" }, sentence(NOT_KEPT)),
      h(
        "div",
        {},
        notice,
        view.failure && problemBox({ title: view.failure.code, detail: view.failure.detail }),
        facts([
          ["Position", inWords(view.position)],
          ["Captured", moment(view.captured_at)],
          ["Enrolled", moment(view.enrolled_at)],
          ["State", view.state],
          ["Id", h("code", {}, view.id)],
        ]),
        view.description &&
          h(
            "details",
            {},
            h("summary", {}, "What it shows"),
            bars(view.description.labels.slice(0, 10).map((one) => [one.label, one.share])),
          ),
        view.state === "ready" && changesSince(view, map),
        editor(view, map, done, failed),
        h("p"),
        h("button", { type: "button", class: "danger", onclick: remove }, "Delete this view …"),
      ),
    ),
  );

  async function done(after) {
    dialog.close();
    await changed(after);
    // What the dialog was opened from has been drawn anew.
    if (document.activeElement === document.body) document.getElementById("main").focus({ preventScroll: true });
  }
  async function remove() {
    if (
      !(await confirmed({
        title: "Delete this view?",
        text: "The view and its image are deleted. This cannot be undone.",
        action: "Delete the view",
      }))
    )
      return;
    try {
      await showReceipt("The view is deleted", await call("DELETE", view.links.self));
      done(null);
    } catch (error) {
      failed(error);
    }
  }
  function failed(error) {
    gone = error.status === 404;
    notice.replaceChildren(problemBox(error));
  }
  dialog.addEventListener("close", () => {
    dialog.remove();
    if (gone) changed(null);
  });
  document.body.append(dialog);
  if (map.keep_images) choices[0].click();
  dialog.showModal();
}

/** The form of what can be edited; what somebody else changed meanwhile stays as it is unless it is changed here. */
function editor(view, map, done, failed) {
  const position = view.position ?? {};
  const geographic =
    position.lat !== undefined && position.lat !== null
      ? true
      : position.x === undefined || position.x === null
        ? isNumber(map.extent?.minimum.lat)
        : false;
  const names = [...(geographic ? ["lat", "lon", "alt"] : ["x", "y", "z"]), "heading"];
  const inputs = Object.fromEntries(
    names.map((name) => [
      name,
      h("input", { inputmode: "decimal", value: isNumber(position[name]) ? String(position[name]) : "" }),
    ]),
  );
  const place = h("input", { maxlength: 200, value: view.place ?? "" });
  const metadata = h("textarea", {
    spellcheck: "false",
    value: Object.keys(view.metadata).length ? JSON.stringify(view.metadata, null, 1) : "",
  });
  const typed = () => [place, ...Object.values(inputs)].map((input) => input.value.trim());
  const [placeBefore, ...positionBefore] = typed();
  const units = {
    x: "x, metres",
    y: "y, metres",
    z: "z, metres",
    lat: "Latitude",
    lon: "Longitude",
    alt: "Altitude, metres",
    heading: "Heading, degrees",
  };

  async function saved(event) {
    event.preventDefault();
    try {
      const changes = {};
      const [placeNow, ...positionNow] = typed();
      if (placeNow !== placeBefore) changes.place = placeNow || null;
      const numbers = Object.fromEntries(
        Object.entries(inputs).map(([name, input]) => [
          name,
          input.value.trim() === "" ? null : number(units[name], input.value),
        ]),
      );
      const kept = metadata.value.trim() ? JSON.parse(metadata.value) : {};
      if (!isObject(kept))
        throw Object.assign(new Error(), { title: "Metadata", detail: 'not a JSON object, such as {"floor": 2}' });
      const empty = Object.values(numbers).every((value) => value === null);
      if (String(positionNow) !== String(positionBefore)) changes.position = empty ? null : numbers;
      changes.metadata = mergePatch(view.metadata, kept);
      done(await call("PATCH", view.links.self, { json: changes, type: "application/merge-patch+json" }));
    } catch (error) {
      failed(
        error instanceof SyntaxError ? { title: "Metadata", detail: `not a JSON object: ${error.message}` } : error,
      );
    }
  }
  return h(
    "details",
    {},
    h("summary", {}, "Edit"),
    h(
      "form",
      { onsubmit: saved },
      h("div", { class: "spaced" }, field("Place", place)),
      h(
        "div",
        { class: "fields" },
        names.map((name) => field(units[name], inputs[name])),
      ),
      h("div", { class: "spaced" }, field("Metadata, a JSON object", metadata)),
      h("button", { type: "submit", class: "first" }, "Save"),
    ),
  );
}

const isNumber = (value) => typeof value === "number";
const isObject = (value) => typeof value === "object" && value !== null && !Array.isArray(value);

/** The merge patch (RFC 7396) that makes object `after` of object `before`: null for each name that goes. */
function mergePatch(before, after) {
  const removed = Object.keys(before).filter((name) => !Object.hasOwn(after, name));
  const made = Object.entries(after)
    .filter(([name, value]) => JSON.stringify(value) !== JSON.stringify(before[name]))
    .map(([name, value]) => [
      name,
      isObject(value) && isObject(before[name]) ? mergePatch(before[name], value) : value,
    ]);
  return Object.fromEntries([...removed.map((name) => [name, null]), ...made]);
}

function number(name, text) {
  const value = Number(text.replace(",", "."));
  if (!Number.isFinite(value)) throw Object.assign(new Error(), { title: name, detail: `${text} is no number` });
  return value;
}
