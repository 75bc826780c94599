// Elements without markup: every text stays text, whatever a name or a file contains.

const SVG = "http://www.w3.org/2000/svg";

/**
 * An element. `attributes`: `on*` are listeners, `style` an object, all others as in HTML; null leaves one out. While
 * the promise of a listener is not settled, further clicks and submits of its element do nothing.
 */
export function h(tag, attributes = {}, ...children) {
  return filled(document.createElement(tag), attributes, children);
}

/** The same for SVG. */
export function svg(tag, attributes = {}, ...children) {
  return filled(document.createElementNS(SVG, tag), attributes, children);
}

function filled(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (["onclick", "onsubmit"].includes(name)) element.addEventListener(name.slice(2), oneAtATime(value));
    else if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "style") for (const [key, text] of Object.entries(value)) element.style.setProperty(key, text);
    else if (name === "value") element.value = value;
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(
    ...children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false),
  );
  return element;
}

function oneAtATime(listener) {
  let going = false;
  return async (event) => {
    if (going) {
      event.preventDefault(); // a form would be sent by the browser
      return;
    }
    const button = event.submitter ?? event.currentTarget;
    const began = listener(event);
    if (!(began instanceof Promise)) return;
    going = true;
    button.setAttribute("aria-disabled", "true"); // not disabled: it would lose the focus
    try {
      await began;
    } finally {
      going = false;
      button.removeAttribute("aria-disabled");
    }
  };
}

/** What an input for the name of a map takes; browsers say the title with their refusal of any other text. */
export const MAP_NAME = {
  pattern: "[A-Za-z0-9][A-Za-z0-9_.\\-]{0,63}",
  title: "Letters, digits, dots, hyphens and underscores, no spaces; a letter or a digit first, 64 at most",
  spellcheck: "false",
};

let fields = 0;

/** A control with its label above it; `wide`: over the whole row. */
export function field(text, control, wide = false) {
  control.id ||= `field-${++fields}`;
  return h("div", { class: wide ? "field wide" : "field" }, h("label", { for: control.id }, text), control);
}

export function checkbox(text, attributes = {}) {
  const box = h("input", { type: "checkbox", ...attributes });
  return { box, label: h("label", { class: "inline" }, box, text) };
}

/** A button that opens the system's choice of files. */
export function picker(text, attributes, chosen) {
  const input = h("input", {
    type: "file",
    "aria-label": text,
    ...attributes,
    onchange: () => {
      chosen([...input.files]);
      input.value = "";
    },
  });
  return h("span", { class: "button pick" }, h("span", { "aria-hidden": "true" }, text), input);
}

/** Make an element take files that are dropped on it, and those in folders. */
export function takesDrops(element, dropped) {
  element.addEventListener("dragover", (event) => {
    event.preventDefault();
    element.classList.add("over");
  });
  element.addEventListener("dragleave", () => element.classList.remove("over"));
  element.addEventListener("drop", (event) => {
    event.preventDefault();
    element.classList.remove("over");
    filesOf(event.dataTransfer).then((files) => files.length && dropped(files));
  });
}

/** Ignore files that are dropped where nothing takes them: the browser would open them in place of the page. */
export function keepsDrops() {
  const hold = (event) => {
    if (event.defaultPrevented || !event.dataTransfer?.types.includes("Files")) return;
    event.preventDefault();
    event.dataTransfer.dropEffect = "none";
  };
  for (const kind of ["dragover", "drop"]) window.addEventListener(kind, hold);
}

/** The files of a drop. A folder is opened; with one, each file tells its path as a chosen folder's do. */
async function filesOf({ items, files }) {
  const plain = [...files]; // what was dropped is gone once this waits
  const entries = [...items].map((item) => item.webkitGetAsEntry()).filter(Boolean);
  if (!entries.some((entry) => entry.isDirectory)) return plain;
  return (await Promise.all(entries.map(within))).flat();
}

async function within(entry) {
  if (entry.isFile) {
    const file = await new Promise((resolve, reject) => entry.file(resolve, reject)).catch(() => null);
    return file ? [Object.defineProperty(file, "webkitRelativePath", { value: entry.fullPath.slice(1) })] : [];
  }
  const reader = entry.createReader();
  const found = [];
  for (let some = null; some === null || some.length; found.push(...some))
    some = await new Promise((resolve, reject) => reader.readEntries(resolve, reject)).catch(() => []);
  found.sort((one, other) => (one.name < other.name ? -1 : 1));
  return (await Promise.all(found.map(within))).flat();
}

/** Say something to those who listen instead of looking. */
export function announce(text) {
  document.getElementById("announce").textContent = text;
}

/** What was wrong, what to do, and the id under which the service's log has it. */
export function problemBox(problem) {
  const wrong = problem.errors ?? [];
  return h(
    "div",
    { class: "problem", role: "alert" },
    h(
      "p",
      {},
      h("strong", {}, problem.title ?? "Something went wrong in the console"),
      ": ",
      problem.detail ?? problem.message,
    ),
    wrong.length > 0 &&
      h(
        "ul",
        {},
        wrong.map((one) => h("li", {}, h("code", {}, one.parameter), " ", one.detail)),
      ),
    problem.requestId && h("p", { class: "quiet" }, "request ", h("code", {}, problem.requestId)),
  );
}

/** Fill an element with a problem. One that it shows already stays: it would be read out again. */
export function showProblem(element, problem) {
  const box = problemBox(problem);
  const shown = element.firstElementChild;
  const same = shown?.matches(".problem") && shown.firstChild.textContent === box.firstChild.textContent;
  if (!same) element.replaceChildren(box);
}

/** The problem that a screen met when it was opened, and a button that opens it once more. */
export function screenProblem(problem) {
  const again = () => window.dispatchEvent(new Event("again"));
  return h(
    "div",
    { class: "spaced" },
    problemBox(problem),
    h("button", { type: "button", onclick: again }, "Try again"),
  );
}

/** Rows of names and numbers with a bar each; `of`: the value of a full bar. */
export function bars(rows, { of = 1, text = percent, className = "bars" } = {}) {
  return h(
    "ul",
    { class: className },
    rows.map(([name, value, kind]) =>
      h(
        "li",
        { class: kind },
        h("span", { class: "name" }, name),
        h(
          "span",
          { class: "bar", "aria-hidden": "true" },
          h("span", { style: { width: `${Math.max(0, Math.min(1, value / of)) * 100}%` } }),
        ),
        h("span", { class: "number" }, text(value)),
      ),
    ),
  );
}

/** A table of `rows`, each a list of cells. */
export function table(columns, rows) {
  const heads = columns.map((name) => h("th", { scope: "col" }, name));
  const lines = rows.map((cells) =>
    h(
      "tr",
      {},
      cells.map((cell) => h("td", {}, cell)),
    ),
  );
  return h("table", {}, h("thead", {}, h("tr", {}, heads)), h("tbody", {}, lines));
}

/** Names and values, without those that are missing. */
export function facts(rows) {
  return h(
    "dl",
    {},
    rows
      .filter(([, value]) => value !== null && value !== undefined && value !== "")
      .map(([name, value]) => [h("dt", {}, name), h("dd", {}, value)]),
  );
}

/** What `work` gives; until then the browser asks before the tab is closed or left. */
export async function staying(work) {
  const ask = (event) => event.preventDefault();
  window.addEventListener("beforeunload", ask);
  try {
    return await work();
  } finally {
    window.removeEventListener("beforeunload", ask);
  }
}

/** Details whose content is made when they are opened first. */
export function folded(title, make) {
  const body = h("div");
  const details = h(
    "details",
    {
      ontoggle: () => {
        if (details.open && !body.firstChild) body.append(make());
      },
    },
    h("summary", {}, title),
    body,
  );
  return details;
}

export const percent = (value) =>
  value > 0 && value < 0.01 ? "< 1 %" : value < 1 && value > 0.99 ? "> 99 %" : `${Math.round(value * 100)} %`;
export const decimals = (value, digits = 2) => (value === null || value === undefined ? "–" : value.toFixed(digits));
export const count = (value, one, many = `${one}s`) => `${value.toLocaleString("en-GB")} ${value === 1 ? one : many}`;

/** Words of the service, which begin small and end without a full stop, as a sentence. */
export const sentence = (text) =>
  text ? `${text[0].toUpperCase()}${text.slice(1)}${/[.!?]$/.test(text) ? "" : "."}` : "";

export function size(bytes) {
  for (const [unit, power] of [
    ["GB", 1e9],
    ["MB", 1e6],
    ["kB", 1e3],
  ])
    if (bytes >= power) return `${(bytes / power).toFixed(1)} ${unit}`;
  return `${bytes} bytes`;
}

export function moment(text) {
  return text ? new Date(text).toLocaleString("en-GB", { dateStyle: "medium", timeStyle: "short" }) : null;
}

/** A position in words: metres of the map's frame, or degrees. */
export function place(position) {
  if (!position) return null;
  const heading = position.heading === null ? "" : `, heading ${decimals(position.heading, 0)}°`;
  if (position.x !== null) {
    const height = position.z === null ? "" : `, z ${decimals(position.z)}`;
    return `x ${decimals(position.x)}, y ${decimals(position.y)}${height} m${heading}`;
  }
  if (position.lat !== null) return `${decimals(position.lat, 6)}°, ${decimals(position.lon, 6)}°${heading}`;
  return heading.slice(2) || null;
}

/** Ask before something is lost; `typed`: a text that has to be typed first. Resolves to whether it may be done. */
export function confirmed({ title, text, action, typed = null }) {
  return new Promise((resolve) => {
    const input =
      typed &&
      h("input", {
        autocomplete: "off",
        spellcheck: "false",
        oninput: () => {
          sure.disabled = input.value !== typed;
        },
      });
    const sure = h("button", { type: "submit", class: "danger", disabled: Boolean(typed) }, action);
    const dialog = h(
      "dialog",
      { class: "small", "aria-labelledby": "confirm-title" },
      h("h2", { id: "confirm-title" }, title),
      h("p", {}, text),
      h(
        "form",
        {
          onsubmit: (event) => {
            event.preventDefault();
            dialog.close("yes");
          },
        },
        typed && h("div", { class: "spaced" }, field(`To go on, type ${typed}`, input)),
        h("div", { class: "row" }, sure, h("button", { type: "button", onclick: () => dialog.close() }, "Cancel")),
      ),
    );
    dialog.addEventListener("close", () => {
      dialog.remove();
      resolve(dialog.returnValue === "yes");
    });
    document.body.append(dialog);
    dialog.showModal();
  });
}
