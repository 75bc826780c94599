// Enrol: many photos, where each was taken, and what became of each.

import { call } from "./api.js";
import { mapSelect } from "./choice.js";
import { attributesOf, positionsOf } from "./csv.js";
import { MAP_NAME, announce, checkbox, count, field, h, picker, problemBox, staying, takesDrops } from "./dom.js";
import { NOT_SHOWN } from "./images.js";
import { placing } from "./placing.js";
import { FRAMES, typedPosition } from "./positions.js";
import { RECORDINGS, recording } from "./recording.js";

const AT_ONCE = 2;
const TRIES = 5;
const PASSING = { 0: "does not answer", 429: "is busy", 503: "is busy" }; // it may be starting again
const FOR_ALL = [0, 401, 507]; // away, without a key, the disk is full: the other photos would get the same
const IMAGES = /\.(jpe?g|png|webp|bmp|tiff?|heic|heif)$/i;

/** What was wrong with one photo, in a line. */
function refusal({ title = "Error", detail, message, errors = [] }) {
  const parameters = errors.map((wrong) => `; ${wrong.parameter}: ${wrong.detail}`).join("");
  return `${title}: ${detail ?? message}${parameters}`;
}

/** Whether what is typed about a photo still goes with it. */
const isOpen = ({ state }) => state === "waiting" || state === "refused";

const isThere = () =>
  call("GET", "/version", { quiet: true }).then(
    () => true,
    () => false,
  );

export function enrolScreen() {
  let entries = [];
  let positions = null;
  let reading = 0; // tables that are being read: photos must not be enrolled without what these say
  let running = false;
  let current = null; // the photo whose fields were used last

  const maps = mapSelect(() => onPlan.draw());
  const other = h("input", {
    onchange: () => onPlan.draw(),
    placeholder: "a new one",
    ...MAP_NAME,
  });
  const place = h("input", { maxlength: 200, placeholder: "for all without one" });
  const frame = h(
    "select",
    {},
    FRAMES.map(([value, text]) => h("option", { value }, text)),
  );
  const exif = checkbox("Position and time from the photos (EXIF), where none is given");
  const list = h("ul", { class: "files", "aria-label": "Photos to enrol", tabindex: "0", hidden: true });
  const notice = h("div");
  const bar = h("progress", { value: 0, max: 1, "aria-label": "Photos enrolled", hidden: true });
  const summary = h("p", { class: "quiet" });
  const start = h("button", { type: "submit", class: "first", disabled: true }, "Enrol");
  const clear = h(
    "button",
    {
      type: "button",
      onclick: () => {
        entries = [];
        positions = null;
        notice.replaceChildren();
        redraw();
      },
    },
    "Clear the list",
  );
  const drop = h(
    "div",
    { class: "drop" },
    h("p", {}, "Drop photos here, and a CSV file with their positions, or"),
    h(
      "div",
      { class: "row" },
      picker("Choose photos", { accept: "image/*", multiple: true }, add),
      picker("Choose a folder", { webkitdirectory: true, multiple: true }, add),
      picker("Take a photo", { accept: "image/*", capture: "environment" }, add),
      picker("Positions (CSV)", { accept: ".csv,.tsv,text/csv" }, add),
    ),
  );
  takesDrops(drop, add);

  const wanted = async () => other.value.trim() || (await maps.chosen());
  const archives = recording(wanted, () => maps.refresh().catch(() => {}));
  const onPlan = placing(wanted, nextToPlace);

  /** The photo that a click on the plan places: the one in use, else the first without a position. */
  function nextToPlace() {
    const open = entries.filter(isOpen);
    const one = open.includes(current) ? current : open.find((other) => !other.position.value);
    return one ? { name: one.path, put: (position) => put(one, position) } : null;
  }

  function put(one, { x, y, lat, lon }) {
    frame.value = x === undefined ? "degrees" : "metres";
    const heading = one.position.value.split(/[\s,;]+/)[2];
    const spot = x === undefined ? [lat.toFixed(6), lon.toFixed(6)] : [x.toFixed(2), y.toFixed(2)];
    one.position.value = [...spot, heading].filter(Boolean).join(", ");
    current = null;
  }

  async function add(files) {
    notice.replaceChildren();
    const recordings = files.filter((file) => RECORDINGS.test(file.name));
    if (recordings.length) archives.take(recordings);
    files = files.filter((file) => !recordings.includes(file));
    const tables = files.filter((file) => /\.[ct]sv$/i.test(file.name));
    const images = files.filter(
      (file) => !tables.includes(file) && (file.type.startsWith("image/") || IMAGES.test(file.name)),
    );
    const skipped = files.filter((file) => !tables.includes(file) && !images.includes(file));
    if (skipped.length)
      notice.append(
        h(
          "p",
          { class: "refused" },
          `Left out, since they are no images: ${skipped
            .slice(0, 5)
            .map((file) => file.name)
            .join(", ")}${skipped.length > 5 ? " and others" : ""}.`,
        ),
      );
    let read = false;
    for (const table of tables) {
      reading += 1;
      redraw();
      try {
        positions = positionsOf(await table.arrayBuffer());
        read = true;
      } catch (error) {
        notice.append(problemBox({ title: table.name, detail: error.message }));
      }
      reading -= 1;
    }
    const added = images.map((file) => entry(file));
    entries.push(...added);
    const meant = read ? entries : added; // an earlier table does not undo what was typed since
    if (positions && (read || added.length)) {
      const fitted = meant.filter((one) => isOpen(one) && fill(one, attributesOf(positions, one.path)));
      notice.append(
        h(
          "p",
          {},
          `The CSV file has ${count(positions.size, "row")}; `,
          `${fitted.length} of ${count(meant.length, "photo")} have one.`,
        ),
      );
    }
    redraw();
  }

  function entry(file) {
    const one = {
      file,
      path: file.webkitRelativePath || file.name,
      state: "waiting",
      detail: "",
      more: {},
      url: URL.createObjectURL(file),
    };
    one.place = h("input", { "aria-label": `Place of ${file.name}`, placeholder: "place", maxlength: 200 });
    one.position = h("input", {
      "aria-label": `Position of ${file.name}`,
      placeholder: "position",
      spellcheck: "false",
    });
    one.status = h("span", { class: "waiting" }, "waiting");
    const notShown = h("span", { class: "not-shown", title: NOT_SHOWN });
    one.element = h(
      "li",
      { onfocusin: () => used(one) },
      h("img", { src: one.url, alt: "", loading: "lazy", onerror: ({ target }) => target.replaceWith(notShown) }),
      h(
        "div",
        {},
        h("span", { class: "name" }, one.path),
        " ",
        one.status,
        h("div", { class: "fields" }, one.place, one.position),
      ),
    );
    return one;
  }

  function fill(one, row) {
    if (!row) return false;
    const { place: name, x, y, lat, lon, heading, ...more } = row;
    one.place.value = name ?? one.place.value;
    if (x !== undefined || lat !== undefined) {
      frame.value = x === undefined ? "degrees" : "metres";
      one.position.value = [x ?? lat, y ?? lon, heading].filter((value) => value !== undefined).join(", ");
    } else if (heading !== undefined) more.heading = heading;
    one.more = more;
    return true;
  }

  function used(one) {
    current = one;
    onPlan.update();
  }

  function redraw() {
    onPlan.update();
    const focused = document.activeElement;
    list.replaceChildren(...entries.map((one) => one.element));
    if (list.contains(focused)) focused.focus({ preventScroll: true });
    list.hidden = entries.length === 0;
    const left = entries.filter((one) => one.state !== "done").length;
    start.disabled = running || reading > 0 || left === 0;
    const again = left > 0 && entries.every((one) => ["done", "refused"].includes(one.state));
    start.textContent = left ? `${again ? "Try again: enrol" : "Enrol"} ${count(left, "photo")}` : "Enrol";
    clear.disabled = running || entries.length === 0;
  }

  /** The parts of one enrolment; raises Problem for a position that cannot be read. */
  function formOf(one, map) {
    const form = new FormData();
    form.append("image", one.file, one.file.name);
    form.append("map", map);
    const name = one.place.value.trim() || place.value.trim();
    if (name) form.append("place", name);
    const spot = typedPosition(one.position.value, frame.value);
    for (const [key, value] of Object.entries(spot)) form.append(key, value);
    for (const [key, value] of Object.entries(one.more)) form.append(key, value);
    if (exif.box.checked) form.append("exif", "true");
    return form;
  }

  /** Say how far a photo is. What is typed once it is sent would come too late, so nothing can be. */
  function mark(one, state, text) {
    one.state = state;
    one.place.readOnly = one.position.readOnly = state === "sending" || state === "done";
    one.status.className = state;
    one.status.replaceChildren(text);
  }

  async function enrol(one, map) {
    let form;
    try {
      form = formOf(one, map);
    } catch (error) {
      mark(one, "refused", refusal(error));
      return;
    }
    for (let tried = 1; ; tried += 1) {
      try {
        mark(one, "sending", "sending …");
        const { view, created, warnings } = await call("POST", "/enroll", { form });
        const came = !created ? "was there already" : view.state === "pending" ? "kept, described later" : "enrolled";
        const { lat, lon } = view.position ?? {};
        const where = exif.box.checked && lat != null ? ` at ${lat.toFixed(6)}, ${lon.toFixed(6)}` : "";
        mark(one, "done", [came + where, ...warnings.map((warning) => warning.detail)].join("; "));
        one.place.value = view.place ?? "";
        return;
      } catch (error) {
        if (error.status === 0 && tried > 1 && (await isThere())) {
          mark(one, "refused", "The file cannot be sent. Was it changed or removed? Choose it again");
          return;
        }
        if (Object.hasOwn(PASSING, error.status) && tried < TRIES) {
          const seconds = error.retryAfter ?? 2 ** tried;
          mark(one, "sending", `the service ${PASSING[error.status]}; again in ${seconds} s`);
          await new Promise((resolve) => setTimeout(resolve, seconds * 1000));
        } else {
          mark(one, "refused", refusal(error));
          if (FOR_ALL.includes(error.status)) throw error;
          return;
        }
      }
    }
  }

  async function run(event) {
    event.preventDefault();
    const queue = entries.filter((one) => one.state !== "done");
    const whole = queue.length;
    let finished = 0;
    let map = null;
    running = true;
    bar.hidden = false;
    redraw();
    const tell = () => {
      const refused = entries.filter((one) => one.state === "refused").length;
      bar.value = whole ? finished / whole : 1;
      summary.textContent = `${finished} of ${count(whole, "photo")} done${refused ? `, ${refused} refused` : ""}.`;
    };
    tell();
    try {
      map = await wanted();
      const enrolling = async () => {
        for (let one = queue.shift(); one; one = queue.shift()) {
          try {
            await enrol(one, map);
          } catch (error) {
            queue.length = 0;
            throw error;
          }
          finished += 1;
          tell();
        }
      };
      const ended = await staying(() => Promise.allSettled(Array.from({ length: AT_ONCE }, enrolling)));
      const failed = ended.find(({ reason }) => reason);
      if (failed) throw failed.reason;
      announce(summary.textContent);
    } catch (error) {
      if (error.status !== 401) notice.replaceChildren(problemBox(error));
    } finally {
      running = false;
      entries.sort((one, other) => (other.state === "refused") - (one.state === "refused")); // where they are seen
      redraw();
      if (map !== null) await enrolledIn(map);
    }
  }

  /** Choose the map that photos went to, if it is there: one that no photo came to is still to be made. */
  async function enrolledIn(map) {
    const all = await maps.refresh(map).catch(() => []);
    if (all.some((one) => one.name === map) && other.value.trim() === map) other.value = "";
  }

  return {
    element: h(
      "div",
      {},
      h("h1", {}, "Enrol photos of places"),
      h(
        "form",
        { class: "panel", onsubmit: run },
        drop,
        h("p"),
        h(
          "div",
          { class: "fields" },
          field("Map", maps.select),
          field("or a new map", other),
          field("Place", place),
          field("Positions are in", frame),
        ),
        exif.label,
        onPlan.element,
        notice,
        h("div", { class: "row" }, start, clear),
        bar,
        summary,
      ),
      archives.element,
      h(
        "section",
        { class: "panel", "aria-label": "Photos" },
        list,
        h(
          "details",
          {},
          h("summary", {}, "A CSV file of positions"),
          h(
            "p",
            {},
            "Its first line names columns: file, and some of place, x, y, z, lat, lon, alt, heading, captured_at. ",
            "A row belongs to the photos whose path ends with its file. Commas, semicolons or tabs separate, and the ",
            "text is UTF-8:",
          ),
          h("pre", {}, "file,place,x,y,heading\nentrance.jpg,main entrance,12.0,3.5,90"),
        ),
      ),
    ),
    enter: async () => {
      await maps.refresh();
    },
  };
}
