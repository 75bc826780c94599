// Run by a test: node odd.mjs CLIENT; prints what a client makes of gateways, aborts and streams as JSON.

import { createServer } from "node:http";

const { Problem, Revisit } = await import(process.argv[2]);
const ANSWERS = {
  "/stalls": (answer) => {
    answer.writeHead(503, { "Content-Type": "application/problem+json" });
    answer.write('{"type":');
  },
  "/date": (answer) => {
    answer.writeHead(503, { "Retry-After": new Date(Date.now() + 60_000).toUTCString() });
    answer.end("<h1>busy</h1>");
  },
  "/gateway": (answer) => {
    answer.writeHead(502, { "Content-Type": "application/json" });
    answer.end('{"title": 7, "detail": ["upstream"], "errors": "upstream"}');
  },
  "/sent": async (answer, request) => {
    let sent = 0;
    for await (const piece of request) sent += piece.length;
    answer.end(JSON.stringify({ sent }));
  },
};
const server = createServer((request, answer) => ANSWERS[request.url](answer, request));
await new Promise((ready) => server.listen(0, "127.0.0.1", ready));
const revisit = new Revisit(`http://127.0.0.1:${server.address().port}`);

async function told(call) {
  try {
    return await (await call()).json();
  } catch (error) {
    if (!(error instanceof Problem)) return String(error);
    const { status, title, detail, errors } = error;
    return { status, title, detail, errors, waits: (error.retryAfter ?? 0) > 0 };
  }
}

const pieces = new ReadableStream({
  start(stream) {
    for (let piece = 0; piece < 3; piece += 1) stream.enqueue(new Uint8Array(1000));
    stream.close();
  },
});

const aborted = new AbortController();
setTimeout(() => aborted.abort(new Error("another page")), 200);
console.log(
  JSON.stringify([
    await told(() => revisit.send("GET", "/stalls", { signal: aborted.signal })),
    await told(() => revisit.send("GET", "/date")),
    await told(() => revisit.send("GET", "/gateway")),
    await told(() => revisit.send("POST", "/sent", { body: pieces })),
    await told(() => new Revisit("localhost:8000").send("GET", "/version")),
  ]),
);
process.exit();
