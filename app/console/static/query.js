// Ask: a photo, and where it was taken.

import { answerPanel } from "./answer.js";
import { Problem, call } from "./api.js";
import { mapSelect } from "./choice.js";
import { announce, checkbox, count, field, h, picker, problemBox, takesDrops } from "./dom.js";
import { snippets } from "./snippets.js";

const GONE = { title: "The photo cannot be sent", detail: "its file was changed or removed; choose it again" };

/** Whether a file can still be read; of one that was removed the beginning has no bytes. */
const isReadable = (file) =>
  file
    .slice(0, 1)
    .arrayBuffer()
    .then(
      (bytes) => bytes.byteLength > 0,
      () => false,
    );

export function queryScreen() {
  let file = null;
  let url = null;
  let asked = 0;

  const maps = mapSelect((facts) => {
    about.textContent = facts
      ? `${count(facts.views.ready ?? 0, "view")} of ${count(facts.places, "place")} to compare with`
      : "nothing is enrolled there yet";
  });
  const about = h("p", { class: "quiet" });
  const photo = h("div");
  const drop = h(
    "div",
    { class: "drop" },
    photo,
    h("p", {}, "Drop a photo here, paste one, or"),
    h(
      "div",
      { class: "row" },
      picker("Choose a photo", { accept: "image/*" }, take),
      picker("Take a photo", { accept: "image/*", capture: "environment" }, take),
    ),
  );
  takesDrops(drop, take);

  const precision = h(
    "select",
    {},
    [
      ["", "as the map says"],
      ["0.9", "90 of 100"],
      ["0.95", "95 of 100"],
      ["0.97", "97 of 100"],
      ["0.99", "99 of 100"],
      ["0.999", "999 of 1,000"],
    ].map(([value, text]) => h("option", { value }, text)),
  );
  const inputs = {
    top: h("input", { type: "number", min: 1, max: 100, value: "5" }),
    zoom: h("input", { placeholder: "1", inputmode: "decimal", spellcheck: "false" }),
    roll: h("input", { placeholder: "0", spellcheck: "false" }),
    place: h("input", { maxlength: 200 }),
    near: h("input", { placeholder: "12.5,3.0,20", spellcheck: "false" }),
    after: h("input", { placeholder: "2026-03-01T09:30:00Z", spellcheck: "false" }),
    before: h("input", { placeholder: "2026-03-31T00:00:00Z", spellcheck: "false" }),
    exclude_last: h("input", { placeholder: "10 or 30s", spellcheck: "false" }),
    drive: h("input", { placeholder: "robot-7", spellcheck: "false" }),
    drive_timeout: h("input", { placeholder: "60", inputmode: "decimal", spellcheck: "false" }),
    metadata: h("input", { placeholder: "floor=2", spellcheck: "false" }),
    where: h("input", { placeholder: '{"place": {"$prefix": "hall/"}}', spellcheck: "false" }),
    also: h("input", { placeholder: "floor2,floor3", spellcheck: "false" }),
  };
  const frame = h("select", {}, h("option", { value: "" }, "metres"), h("option", { value: "geo" }, "degrees"));
  const explain = checkbox("Draw what agrees", { checked: true });
  const again = h("button", { type: "submit", class: "first", disabled: true }, "Ask");
  const form = h(
    "form",
    {
      onsubmit: (event) => {
        event.preventDefault();
        ask();
      },
    },
    drop,
    h("p"),
    h("div", { class: "fields" }, field("Map", maps.select), field("Right answers among the sure ones", precision)),
    about,
    h(
      "details",
      {},
      h("summary", {}, "Filters and more"),
      h(
        "div",
        { class: "fields" },
        field("Matches at most", inputs.top),
        field("Zoom against the map's camera", inputs.zoom),
        field("Turned clockwise, degrees", inputs.roll),
        field("Only the place", inputs.place),
        field("Near x,y,radius", inputs.near),
        field("Near is in", frame),
        field("Captured after", inputs.after),
        field("Captured before", inputs.before),
        field("Without the newest", inputs.exclude_last),
        field("Metadata", inputs.metadata),
        field("Condition, as JSON", inputs.where),
        field("These maps as well", inputs.also),
      ),
    ),
    h(
      "details",
      {},
      h("summary", {}, "Photos of one drive"),
      h(
        "p",
        { class: "quiet" },
        "Under one name the evidence of consecutive photos adds up. Ask them in the order in which they were taken, ",
        "each once.",
      ),
      h(
        "div",
        { class: "fields" },
        field("Name of the drive", inputs.drive),
        field("Forgotten after, seconds", inputs.drive_timeout),
      ),
    ),
    h("div", { class: "row between" }, explain.label, again),
  );
  const result = h("div", {}, h("p", { class: "quiet" }, "The answer appears here: the place, how sure, and why."));
  const below = h("div");

  function take([chosen, ...others]) {
    if (!chosen) return;
    if (url) URL.revokeObjectURL(url);
    file = chosen;
    url = URL.createObjectURL(chosen);
    const preview = h("img", {
      src: url,
      alt: `Your photo, ${chosen.name}`,
      onerror: () => {
        preview.replaceWith(h("p", {}, chosen.name));
      },
    });
    const first = `The first of ${others.length + 1} files: one photo is asked at a time.`;
    photo.replaceChildren(preview, others.length ? h("p", { class: "quiet" }, first) : "");
    again.disabled = false;
    ask();
  }

  /** What is sent besides the image; the console adds nothing that a curl call could not. */
  async function parameters() {
    const given = {
      map: await maps.chosen(),
      precision: precision.value,
      explain: explain.box.checked ? "true" : "",
      frame: inputs.near.value && frame.value,
    };
    for (const [name, input] of Object.entries(inputs)) given[name] = input.value.trim();
    if (given.metadata) {
      const [, name, value] = /^([^=]+?)\s*=\s*(.+)$/.exec(given.metadata) ?? [];
      if (!name)
        throw new Problem(0, {
          title: "Metadata",
          detail: `a key and its value are needed, as in floor=2; not ${given.metadata}`,
        });
      given[`metadata.${name}`] = value;
    }
    delete given.metadata;
    if (given.top === "5") delete given.top;
    if (given.also) {
      given.maps = `${given.map},${given.also}`;
      delete given.map;
    }
    delete given.also;
    return Object.fromEntries(Object.entries(given).filter(([, text]) => text !== ""));
  }

  async function ask() {
    if (!file) return;
    const mine = ++asked;
    const sent = new FormData();
    sent.append("image", file, file.name || "photo");
    again.disabled = true;
    result.replaceChildren(h("p", {}, "Looking …"));
    below.replaceChildren();
    try {
      const query = await parameters();
      if (mine !== asked) return;
      const answer = await call("POST", "/query", { query, form: sent });
      if (mine !== asked) return;
      const { short, long } = answerPanel(answer, url);
      result.replaceChildren(...short);
      below.replaceChildren(...long, snippets(query, file.name || "photo.jpg"));
      announce(result.querySelector("h2").textContent);
    } catch (error) {
      const sendable = error.status !== 0 || (await isReadable(file));
      if (mine === asked) result.replaceChildren(problemBox(sendable ? error : GONE));
    } finally {
      if (mine === asked) again.disabled = false;
    }
  }

  function pasted(event) {
    const image = [...event.clipboardData.files].find((one) => one.type.startsWith("image/"));
    if (image) take([image]);
  }

  return {
    element: h(
      "div",
      {},
      h("h1", {}, "Where was this taken?"),
      h(
        "div",
        { class: "columns" },
        h("section", { class: "panel", "aria-label": "Your photo" }, form),
        h("section", { "aria-label": "Answer" }, result),
      ),
      below,
    ),
    enter: async () => {
      document.addEventListener("paste", pasted);
      await maps.refresh();
    },
    leave: () => document.removeEventListener("paste", pasted),
  };
}
