// The frame: which screen is shown, sign in, light and dark.

import { call, key } from "./api.js";
import { MAP_NAME, announce, field, h, keepsDrops, problemBox, screenProblem } from "./dom.js";
import { enrolScreen } from "./enrol.js";
import { healthScreen } from "./health.js";
import { inboxScreen } from "./inbox.js";
import { mapScreen } from "./map.js";
import { mapsScreen } from "./maps.js";
import { mapHead } from "./parts.js";
import { queryScreen } from "./query.js";
import { recipeScreen } from "./recipe.js";
import { ofBrowser } from "./remembered.js";
import { serviceScreen } from "./service.js";
import { snapshotsScreen } from "./snapshots.js";

const main = document.getElementById("main");
const kept = new Map(); // screens that go on while others are looked at
let leave = null;
let visits = 0;

const OF_MAP = { health: healthScreen, inbox: inboxScreen, recipe: recipeScreen };
const ofMap = (part) => (Object.hasOwn(OF_MAP, part) ? OF_MAP[part] : mapScreen);
const NAME = new RegExp(`^(?:${MAP_NAME.pattern})$`);
const mapsOrOne = (name, part) => (name ? (NAME.test(name) ? ofMap(part) : noMap)(name) : mapsScreen());

/** What is not asked of the service: fetch would make another address of a name such as "..". */
function noMap(name) {
  const problem = { title: "There is no such map", detail: `${name} is no name of a map. ${MAP_NAME.title}` };
  return { element: h("div", {}, mapHead(name), problemBox(problem)) };
}

const SCREENS = {
  ask: { title: "Ask", make: queryScreen, keep: true },
  enrol: { title: "Enrol", make: enrolScreen, keep: true },
  maps: { title: "Maps", make: mapsOrOne },
  snapshots: { title: "Snapshots", make: snapshotsScreen, under: "maps", keep: true },
  service: { title: "Service", make: serviceScreen },
};

/** A part of the address as text; one that was mistyped, such as 100%, is taken as it is. */
function decoded(part) {
  try {
    return decodeURIComponent(part);
  } catch {
    return part;
  }
}

/** Show what the address names: `#ask`, `#maps/campus/health`. A screen may have `enter` and `leave`. */
async function show() {
  const [name, ...rest] = location.hash.slice(1).split("/");
  const chosen = Object.hasOwn(SCREENS, name) ? name : "ask";
  const { title, make, keep, under = chosen } = SCREENS[chosen];
  for (const link of document.querySelectorAll(".top nav a")) {
    if (link.getAttribute("href") === `#${under}`) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  document.title = `${title} · revisit`;
  leave?.();
  const visit = ++visits;
  const screen = kept.get(chosen) ?? make(...rest.map(decoded));
  if (keep) kept.set(chosen, screen);
  leave = screen.leave ?? null;
  const within = main.contains(document.activeElement);
  main.replaceChildren(screen.element);
  if (within) main.focus({ preventScroll: true }); // instead of a link that is gone
  main.setAttribute("aria-busy", "true");
  let problem = null;
  try {
    await screen.enter?.();
  } catch (error) {
    if (error.status !== 401) problem = screenProblem(error); // else the dialog is open
  }
  if (visit !== visits) return; // another screen is shown by now
  if (problem) main.prepend(problem);
  main.removeAttribute("aria-busy");
  main.dataset.screen = location.hash.slice(1);
}

function signIn(problem = null) {
  if (document.getElementById("sign-in")) return;
  const input = h("input", {
    type: "password",
    autocomplete: "off",
    spellcheck: "false",
    required: true,
    "aria-describedby": "sign-in-why",
  });
  const notice = h("div", {}, problem && key.get() ? problemBox(problem) : null);
  const dialog = h(
    "dialog",
    { id: "sign-in", class: "small", "aria-labelledby": "sign-in-title" },
    h("h2", { id: "sign-in-title" }, "Sign in with a key"),
    h(
      "p",
      { id: "sign-in-why", class: "quiet" },
      "The key is kept in this tab alone and forgotten when it closes. ",
      "The operator makes one with ",
      h("code", {}, "./revisit keys create NAME"),
      ".",
    ),
    notice,
    h(
      "form",
      { onsubmit: tried },
      h("div", { class: "spaced" }, field("Key", input)),
      h(
        "div",
        { class: "row" },
        h("button", { type: "submit", class: "first" }, "Sign in"),
        h("button", { type: "button", onclick: leave }, "Close"),
        key.get() &&
          h(
            "button",
            {
              type: "button",
              class: "danger",
              onclick: () => {
                key.forget();
                leave();
                kept.clear();
                show();
              },
            },
            "Forget the key",
          ),
      ),
    ),
  );
  async function tried(event) {
    event.preventDefault();
    const before = key.get();
    key.set(input.value.trim());
    try {
      await call("GET", "/maps", { quiet: true });
      leave();
      announce("signed in");
      restart();
    } catch (error) {
      if (before) key.set(before);
      else key.forget();
      notice.replaceChildren(problemBox(error));
      input.focus();
      input.select();
    }
  }
  // At once: the event of a closed dialog may come after the answer that asks for a key again.
  function leave() {
    dialog.close();
    dialog.remove();
  }
  dialog.addEventListener("close", () => dialog.remove());
  document.body.append(dialog);
  dialog.showModal();
}

/** Begin anew, with what this key may see. Files to be enrolled or restored, and what was typed of them, stay. */
function restart() {
  kept.delete("ask");
  const open = document.querySelector("dialog[open]"); // a view that is being edited belongs to the present screen
  if (open) open.addEventListener("close", show, { once: true });
  else show();
}

const THEMES = { "": "Auto", light: "Light", dark: "Dark" };

function theme(name) {
  const button = document.getElementById("theme");
  if (name) document.documentElement.dataset.theme = name;
  else delete document.documentElement.dataset.theme;
  button.textContent = THEMES[name];
  button.setAttribute("aria-label", `Colours: ${THEMES[name].toLowerCase()}`);
  ofBrowser.setItem("revisit-theme", name);
  window.dispatchEvent(new Event("theme"));
}

document.getElementById("theme").addEventListener("click", () => {
  const names = Object.keys(THEMES);
  theme(names[(names.indexOf(document.documentElement.dataset.theme ?? "") + 1) % names.length]);
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => window.dispatchEvent(new Event("theme")));
document.getElementById("key").addEventListener("click", () => signIn());
document.querySelector(".skip").addEventListener("click", (event) => {
  event.preventDefault();
  main.focus();
});
// A link sends no key: where one is needed, the documentation cannot be opened by one.
const links = () => (document.getElementById("docs").hidden = Boolean(key.get()));
window.addEventListener("key", links);
links();
keepsDrops();
window.addEventListener("again", show);
window.addEventListener("unauthorized", (event) => signIn(event.detail));
window.addEventListener("hashchange", () => {
  // "Back" leaves a dialog with the screen that it was opened from; the one for a key is of every screen.
  for (const dialog of document.querySelectorAll("dialog[open]:not(#sign-in)")) dialog.close();
  show();
  window.scrollTo(0, 0);
});

const remembered = ofBrowser.getItem("revisit-theme");
theme(remembered in THEMES ? remembered : "");
call("GET", "/version", { quiet: true }).then(
  (version) => {
    document.getElementById("version").textContent = version.version;
  },
  () => {},
);
show();
