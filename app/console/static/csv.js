// CSV files of positions, as `./revisit enroll --positions` takes them.

const NUMBERS = ["x", "y", "z", "lat", "lon", "alt", "heading"];
const HALVES = [
  ["x", "y"],
  ["lat", "lon"],
];
const TEXTS = ["place", "captured_at"];

/** Lines of fields; a field in double quotes may hold commas, quotes (doubled) and line ends (RFC 4180). */
export function parsed(text) {
  const rows = [[]];
  let cell = "";
  let inside = false;
  const end = () => {
    rows.at(-1).push(cell);
    cell = "";
  };
  const clean = text.replace(/^\uFEFF/, "");
  for (let at = 0; at < clean.length; at += 1) {
    const letter = clean[at];
    if (inside && letter === '"' && clean[at + 1] === '"') {
      cell += '"';
      at += 1;
    } else if (letter === '"' && (inside || cell === "")) inside = !inside;
    else if (!inside && letter === ",") end();
    else if (!inside && letter === "\n") {
      end();
      rows.push([]);
    } else if (inside || letter !== "\r") cell += letter;
  }
  if (inside) throw new Error("a quoted value is not closed: it would hold all rows behind its quote");
  end();
  return rows.filter((row) => row.some((one) => one.trim() !== ""));
}

/** Attributes by file; raises Error that says what is wrong with the table. */
export function positionsOf(text) {
  const [columns, ...rows] = parsed(text).map((row) => row.map((one) => one.trim()));
  if (!columns?.includes("file"))
    throw new Error("the first line needs to name columns: file, and some of place, x, y, lat, lon, heading");
  const strays = columns.filter((name) => name !== "file" && !NUMBERS.includes(name) && !TEXTS.includes(name));
  if (strays.length)
    throw new Error(`unknown columns ${strays.join(", ")}; known are ${[...NUMBERS, ...TEXTS].join(", ")}`);
  if (new Set(columns).size < columns.length) throw new Error("the first line names a column twice");
  const known = new Map();
  const frames = new Set();
  rows.forEach((row, index) => {
    if (row.slice(columns.length).some((value) => value !== ""))
      throw new Error(`row ${index + 1}: ${row.length} values, and the first line names ${columns.length} columns`);
    const given = columns.map((name, at) => [name, row[at] ?? ""]).filter(([, value]) => value !== "");
    for (const [name, value] of given) {
      if (NUMBERS.includes(name) && !Number.isFinite(Number(value)))
        throw new Error(`row ${index + 1}: ${name} is ${value}, which is no number`);
    }
    const { file, ...attributes } = Object.fromEntries(given);
    if (!file) throw new Error(`row ${index + 1}: names no file`);
    for (const [one, two] of HALVES) {
      if ((attributes[one] === undefined) !== (attributes[two] === undefined))
        throw new Error(`row ${index + 1}: ${one} or ${two} is missing: the other alone is half a position`);
    }
    if (attributes.x !== undefined) frames.add("metres");
    else if (attributes.lat !== undefined) frames.add("degrees");
    const path = file.replaceAll("\\", "/").replace(/^\.\//, "").normalize("NFC");
    if (known.has(path)) throw new Error(`row ${index + 1}: an earlier one is about ${path} too`);
    known.set(path, attributes);
  });
  if (frames.size > 1) throw new Error("some rows have x and y, others lat and lon; send them apart");
  return known;
}

/** The row of an image: the one whose file is the longest ending of its path, or null. */
export function attributesOf(positions, path) {
  path = path.normalize("NFC");
  const parts = path.split("/");
  for (let begin = 0; begin < parts.length; begin += 1) {
    const row = positions.get(parts.slice(begin).join("/"));
    if (row) return row;
  }
  // Browsers tell no folder of single files: a row with one fits when only it ends so.
  const ending = [...positions].filter(([file]) => file.split("/").at(-1) === path);
  return ending.length === 1 ? ending[0][1] : null;
}
