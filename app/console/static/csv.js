// Tables of positions, read as `./revisit enroll --positions` reads them: with commas, semicolons or tabs.

/** Our names of columns, and others that mean the same, as those of manifests do (docs/imports.md). */
export const NAMES = {
  file: "filename file_name filepath file_path path image image_name image_path img",
  place: "place_name place_id",
  x: "x_m easting east utm_easting utm_east pos_x",
  y: "y_m northing north utm_northing utm_north pos_y",
  z: "z_m up pos_z",
  lat: "latitude gps_lat gps_latitude",
  lon: "lng long longitude gps_lon gps_lng gps_longitude",
  alt: "altitude alt_m elevation gps_alt gps_altitude",
  heading: "heading_deg bearing azimuth compass compass_angle",
  captured_at: "timestamp time datetime date_time taken_at capture_time",
};
const NUMBERS = ["x", "y", "z", "lat", "lon", "alt", "heading"];
const METRES = ["x", "y", "z", "alt"];
const HALVES = [
  ["x", "y"],
  ["lat", "lon"],
];
const MEANT = new Map(
  Object.entries(NAMES).flatMap(([ours, others]) => [ours, ...others.split(" ")].map((name) => [name, ours])),
);
const UNIX = /^(\d{9,19})(\.\d+)?$/;
const MINUTE = /^(19|20)\d\d(0[1-9]|1[0-2])(0[1-9]|[12]\d|3[01])([01]\d|2[0-3])[0-5]\d$/;
const COMMA = /^[+-]?\d+,\d+$/;
const THOUSANDS = /^[+-]?[1-9]\d{0,2},\d{3}$/;

/** Lines of fields; a field in double quotes may hold separators, quotes (doubled) and line ends (RFC 4180). */
function parsed(text, separator) {
  const rows = [[]];
  let cell = "";
  let inside = false;
  const end = () => {
    rows.at(-1).push(cell);
    cell = "";
  };
  for (let at = 0; at < text.length; at += 1) {
    const letter = text[at];
    if (inside && letter === '"' && text[at + 1] === '"') {
      cell += '"';
      at += 1;
    } else if (letter === '"' && (inside || cell === "")) inside = !inside;
    else if (!inside && letter === separator) end();
    else if (!inside && (letter === "\n" || letter === "\r")) {
      end(); // the empty line within CR LF is none
      rows.push([]);
    } else cell += letter;
  }
  if (inside) throw new Error("a quoted value is not closed: it would hold all rows behind its quote");
  end();
  return rows.map((row) => row.map((one) => one.trim())).filter((row) => row.some((one) => one !== ""));
}

/** The text of a file, and what separates its columns; spreadsheets may say that in a line of its own, `sep=;`. */
function opened(bytes) {
  let text;
  try {
    text = new TextDecoder("utf-8", { fatal: true }).decode(bytes);
  } catch {
    throw new Error("not a text file in UTF-8; a spreadsheet saves it so as “CSV UTF-8”");
  }
  const said = /^\s*sep=(\t|[^\w\s"])[^\S\r\n]*(?:\r\n?|\n|$)/i.exec(text);
  if (said) return [text.slice(said[0].length), said[1]];
  const [first] = text.trimStart().split(/\r|\n/, 1);
  const [separator] = [",", ";", "\t"].sort((one, other) => first.split(other).length - first.split(one).length);
  return [text, separator];
}

/** Attributes by file, of a table's bytes; raises Error that says what is wrong with it. */
export function positionsOf(bytes) {
  const [text, separator] = opened(bytes);
  const [heads = [], ...rows] = parsed(text, separator);
  while (heads.at(-1) === "") heads.pop(); // spreadsheets keep emptied columns
  const named = heads.map((head) => head.replace(/^#+/, "").trim());
  const columns = named.map((name) => MEANT.get(name.toLowerCase().replaceAll(" ", "_")) ?? name);
  if (!columns.includes("file"))
    throw new Error("the first line needs to name columns: file, and some of place, x, y, lat, lon, heading");
  const strays = columns.filter((name) => !Object.hasOwn(NAMES, name));
  if (strays.length)
    throw new Error(`unknown columns ${strays.join(", ")}; known are ${Object.keys(NAMES).join(", ")}`);
  const twice = columns.find((name, at) => columns.indexOf(name) < at);
  if (twice) throw new Error(`the first line names a column twice: ${twice}`);
  const known = new Map();
  const frames = new Set();
  rows.forEach((row, index) => {
    const wrong = (what) => new Error(`row ${index + 1}: ${what}`);
    if (row.slice(columns.length).some((value) => value !== ""))
      throw wrong(`${row.length} values, and the first line names ${columns.length} columns`);
    const given = {};
    columns.forEach((name, at) => {
      if (row[at]) given[name] = valueOf(name, row[at], separator, wrong);
    });
    const { file, ...attributes } = given;
    if (!file) throw wrong("names no file");
    for (const [one, two] of HALVES) {
      if ((attributes[one] === undefined) !== (attributes[two] === undefined))
        throw wrong(`${one} or ${two} is missing: the other alone is half a position`);
    }
    if (attributes.x !== undefined) {
      frames.add("metres");
      for (const name of ["lat", "lon", "alt"]) delete attributes[name];
    } else if (attributes.lat !== undefined) frames.add("degrees");
    const path = file.replaceAll("\\", "/").replace(/^\.\//, "").normalize("NFC");
    if (known.has(path)) throw wrong(`an earlier one is about ${path} too`);
    known.set(path, attributes);
  });
  if (frames.size > 1) throw new Error("some rows have x and y, others lat and lon; send them apart");
  return known;
}

/** The text of a cell as the service takes it; `wrong` makes the Error that is raised. */
function valueOf(name, text, separator, wrong) {
  if (name === "captured_at") return moment(text, wrong);
  if (!NUMBERS.includes(name)) return text;
  if (separator === "," && METRES.includes(name) && THOUSANDS.test(text))
    throw wrong(`${name} is ${text}, which may have a comma for thousands or for decimals; write it without`);
  const number = COMMA.test(text) ? text.replace(",", ".") : text;
  if (!Number.isFinite(Number(number))) throw wrong(`${name} is ${text}, which is no number`);
  return number;
}

/** A time as it is, or Unix time (in seconds, or whole milli-, micro- or nanoseconds) as RFC 3339. */
function moment(text, wrong) {
  const [, whole] = UNIX.exec(text) ?? [];
  if (!whole) return text;
  if ([11, 14, 17].includes(whole.length) || MINUTE.test(whole))
    throw wrong(`captured_at is ${text}, which is no Unix time of today; write dates as 2026-03-01T09:30:00Z`);
  const power = 3 * Math.max(0, Math.min(3, Math.floor((whole.length - 9) / 3)));
  return new Date((Number(text) / 10 ** power) * 1000).toISOString();
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
