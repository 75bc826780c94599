// The same query for a terminal and for a program.

import { announce, h } from "./dom.js";
import { key } from "./api.js";

const quoted = (text) => `'${text.replaceAll("'", "'\\''")}'`;

function curl(query, name) {
  const file = name.replaceAll(/["\\]/g, "\\$&"); // within its quotes curl splits a name at no comma
  const parts = [`curl -F ${quoted(`image=@"${file}"`)}`];
  if (key.get()) parts.push('-H "X-Api-Key: $REVISIT_KEY"');
  // curl takes what begins with @ or < for a file to send, and a semicolon for the end, in -F.
  for (const [field, value] of Object.entries(query)) parts.push(`--form-string ${quoted(`${field}=${value}`)}`);
  return [...parts, `${location.origin}/query`].join(" \\\n  ");
}

const NUMBERS = ["top", "precision", "candidates", "zoom", "roll", "drive_timeout"];

function python(query, name) {
  const metadata = Object.create(null);
  const options = [];
  for (const [field, value] of Object.entries(query)) {
    if (field.startsWith("metadata.")) metadata[field.slice("metadata.".length)] = value;
    else if (field === "explain") options.push("explain=True");
    else if (field === "frame") options.push("geographic=True");
    else if (field === "near") options.push(`near=(${value})`);
    else if (field === "maps") options.push(`maps=${JSON.stringify(value.split(","))}`);
    else options.push(`${field}=${NUMBERS.includes(field) ? Number(value) : JSON.stringify(value)}`);
  }
  if (Object.keys(metadata).length) options.push(`metadata=${JSON.stringify(metadata)}`);
  const comment = key.get() ? "  # takes the key from REVISIT_KEY" : "";
  return [
    "from revisit_client import Revisit",
    "",
    `with Revisit(${JSON.stringify(location.origin)}) as revisit:${comment}`,
    `    answer = revisit.query(${[JSON.stringify(name), ...options].join(", ")})`,
    "    print(answer.status, answer.confidence, answer.reason.detail)",
  ].join("\n");
}

/** A panel with the query as calls; the key itself is never shown. */
export function snippets(query, name) {
  return h(
    "section",
    { class: "panel" },
    h(
      "details",
      {},
      h("summary", {}, "The same from a program"),
      snippet("curl", curl(query, name)),
      snippet("Python", python(query, name)),
    ),
  );
}

function snippet(title, text) {
  const button = h("button", { type: "button", onclick: copy }, `Copy as ${title}`);
  async function copy() {
    try {
      await navigator.clipboard.writeText(text);
      button.textContent = "Copied";
    } catch {
      // pages without TLS on another host may not write to the clipboard
      getSelection().selectAllChildren(block);
      button.textContent = "Selected: press Ctrl-C";
    }
    announce(button.textContent);
    setTimeout(() => {
      button.textContent = `Copy as ${title}`;
    }, 2000);
  }
  const block = h("pre", { tabindex: "0", "aria-label": `As ${title}` }, text);
  return h("div", {}, block, button, h("p"));
}
