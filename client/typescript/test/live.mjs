// Run by a test with the address of a service: node live.mjs SERVICE CLIENT IMAGE; prints what happened as JSON.

import { readFile } from "node:fs/promises";

const [, , url, client, image] = process.argv;
const { Problem, Revisit } = await import(client);
const revisit = new Revisit(url);
const photo = new File([await readFile(image)], "gate.jpg", { type: "image/jpeg" });

const enrolled = await revisit.enroll(photo, { map: "campus", place: "gate", x: 1, y: 2, "metadata.ignored": undefined });
const answer = await revisit.query(photo, { map: "campus", top: 1 });
const thumbnail = await (await revisit.send("GET", enrolled.view.links.thumbnail, { query: { size: 64 } })).blob();
const once = { idempotencyKey: "keyframe-7" };
await revisit.enroll(photo, { map: "campus" }, once);
const problems = [];
for (const wrong of [
  () => revisit.query(photo, { map: "nowhere" }),
  () => revisit.query(photo, { top: 0 }),
  () => new Revisit("http://127.0.0.1:9").get("/version"),
  () => new Revisit(url, { fetch: async () => new Response('{"version": ') }).get("/version"),
  () => revisit.delete("/maps/{map}/unknown/{place_id}", { path: { map: "campus", place_id: ".." } }),
  () => revisit.get("/maps/{map}", { path: { map: "\ud800" } }),
  () => new Revisit(url, { key: "rv_…" }).get("/version"),
  () => revisit.delete("/views", { query: { map: "campus", place: "gate", "metadata.session": undefined } }),
  () => revisit.enroll(photo, { map: "campus" }, { idempotencyKey: "keyframe 7" }),
  () => revisit.enroll(photo, { map: "elsewhere" }, once),
  () => revisit.get("/version", { signal: AbortSignal.abort(new Error("another page")) }),
  () => revisit.query(photo, { map: "campus" }, { signal: AbortSignal.abort(new Error("a newer frame")) }),
  () => revisit.enroll(photo, { map: "elsewhere" }, { signal: AbortSignal.abort(new Error("a newer frame")) }),
]) {
  try {
    await wrong();
  } catch (error) {
    problems.push(error instanceof Problem ? [error.status, error.code, error.errors.length] : String(error));
  }
}
const facts = await revisit.get("/maps/{map}", { path: { map: "campus" } });
console.log(
  JSON.stringify({
    filename: enrolled.view.filename,
    place: answer.matches[0].view.place,
    ready: facts.views.ready,
    thumbnail: thumbnail.type,
    problems,
  }),
);
