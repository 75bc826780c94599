// A client of revisit over HTTP. Its types are those of the service's OpenAPI document (openapi.d.ts, generated).
//
//   const revisit = new Revisit(address, { key });
//   const answer = await revisit.query(photo, { map: "campus" });
//   if (answer.status === "matched") console.log(answer.places[0].place, answer.confidence);

import type { components, operations, paths } from "./openapi.js";

export type Schemas = components["schemas"];
export type View = Schemas["View"];
export type Enrolled = Schemas["Enrolled"];
export type QueryAnswer = Schemas["QueryAnswer"];
export type EnrollParameters = Query<operations["enroll_enroll_post"]>;
export type QueryParameters = Query<operations["query_query_post"]>;

type Method = "get" | "put" | "post" | "patch" | "delete";
type Operation<M extends Method, P extends keyof paths> = NonNullable<paths[P][M]>;
type Metadata = { [name: `metadata.${string}`]: string | undefined };
type Query<O> = O extends { parameters: { query?: infer Q } } ? NonNullable<Q> & Metadata : never;
type InPath<O> = O extends { parameters: { path: infer I } } ? I : never;
type Content<R> = R extends { content: { "application/json": infer J } } ? J : never;
type Answer<O> = O extends { responses: infer R } ? Content<R[keyof R]> : never;

/** Paths that have a method. */
type PathWith<M extends Method> = { [P in keyof paths]: paths[P][M] extends object ? P : never }[keyof paths];

/** An Idempotency-Key where the service reads one: elsewhere it would promise what nobody keeps. */
type Once<O> = O extends { parameters: { header?: infer H } }
  ? keyof NonNullable<H> extends "Idempotency-Key"
    ? Pick<Options, "idempotencyKey">
    : { idempotencyKey?: undefined }
  : never;

/** What can be sent along; `path` has the values of the names in braces. */
type Typed<O> = Omit<Options, "query" | "idempotencyKey"> & { query?: Query<O> } & Once<O> &
  ([InPath<O>] extends [never] ? { path?: undefined } : { path: InPath<O> });

export interface Options {
  /** Parameters of the URL; those that are null, undefined or "" are left out. */
  query?: Record<string, unknown>;
  /** Body of another kind than JSON: a form, a file. */
  body?: RequestInit["body"];
  /** Body as JSON. */
  json?: unknown;
  /** Media type of the body; of JSON application/json, of a form what the browser makes of it. */
  type?: string;
  signal?: AbortSignal | null;
  /** Calls with the same key are done once: of `/enroll`, and of `/query` with `drive`; 1 to 255 visible ASCII characters. */
  idempotencyKey?: string | null;
}

/** What goes along with an image. */
export type Sending = Pick<Options, "signal" | "idempotencyKey">;

export interface Settings {
  /** A key, or what gives it before each request; null for none. */
  key?: string | (() => string | null);
  /** Another fetch, for tests. */
  fetch?: typeof fetch;
}

/** An error of the service (RFC 9457); `status` is 0 where there was no answer. */
export class Problem extends Error {
  readonly status: number;
  /** The last part of `type`, as docs/errors.md lists them. */
  readonly code: string;
  readonly title: string;
  readonly detail: string;
  readonly errors: { parameter: string; detail: string }[];
  readonly requestId: string | null;
  /** Seconds after which to try again. */
  readonly retryAfter: number | null;

  constructor(status: number, body: Partial<Schemas["Problem"]>, retryAfter: number | null = null) {
    super(typeof body.detail === "string" ? body.detail : "");
    this.status = status;
    this.code = (body.type ?? "").split(":").pop() ?? "";
    // A gateway's JSON has none of these, or something else by their names.
    this.title = typeof body.title === "string" && body.title ? body.title : `Status ${status}`;
    this.detail = typeof body.detail === "string" ? body.detail : "";
    this.errors = Array.isArray(body.errors) ? body.errors : [];
    this.requestId = body.request_id ?? null;
    this.retryAfter = retryAfter;
  }

  /** The problem that a response says; of one that says none, its status. */
  static async of(response: Response): Promise<Problem> {
    const retry = seconds(response.headers.get("Retry-After"));
    try {
      return new Problem(response.status, (await response.json()) as Schemas["Problem"], retry);
    } catch {
      const detail = "the answer was no problem+json; is there a proxy between?";
      return new Problem(response.status, { title: `Status ${response.status}`, detail }, retry);
    }
  }

  /** That no answer came. */
  static silence(detail = "the service cannot be reached; is it running?"): Problem {
    return new Problem(0, { title: "No answer", detail });
  }
}

/** A path with parameters; those that are null, undefined or "" are left out. */
export function address(path: string, query: Record<string, unknown> = {}): string {
  const given = Object.entries(query).filter(([, value]) => value !== null && value !== undefined && value !== "");
  return given.length ? `${path}?${new URLSearchParams(given.map(([name, value]) => [name, String(value)]))}` : path;
}

/** A service. Every call rejects with a Problem, or as fetch does when its signal aborts it. */
export class Revisit {
  readonly #url: string;
  readonly #settings: Settings;

  /** `url`: where the service is, without a slash at the end; "" for that of the page. */
  constructor(url = "", settings: Settings = {}) {
    this.#url = url;
    this.#settings = settings;
  }

  /** Headers that carry the key, if there is one; throws a Problem for what can be none. */
  headers(): Record<string, string> {
    const { key } = this.#settings;
    const given = (typeof key === "function" ? key() : key)?.trim();
    if (given && !/^[!-~]+$/.test(given)) {
      const detail = "the key has letters that no key has; take it as `./revisit keys create` printed it";
      throw new Problem(0, { title: "Nothing was sent", detail });
    }
    return given ? { "X-Api-Key": given } : {};
  }

  /** Which views of a map, or of several, show the place of this image? */
  query(image: Blob, query: QueryParameters = {}, sending: Sending = {}): Promise<QueryAnswer> {
    return this.#call("POST", "/query", { ...sending, query, body: form(image) });
  }

  /** Enrol an image: 201 once it can be found, 202 where that will take longer. */
  enroll(image: Blob, query: EnrollParameters = {}, sending: Sending = {}): Promise<Enrolled> {
    return this.#call("POST", "/enroll", { ...sending, query, body: form(image) });
  }

  get<P extends PathWith<"get">>(path: P, options?: Typed<Operation<"get", P>>): Promise<Answer<Operation<"get", P>>> {
    return this.#call("GET", path, options);
  }

  put<P extends PathWith<"put">>(path: P, options: Typed<Operation<"put", P>>): Promise<Answer<Operation<"put", P>>> {
    return this.#call("PUT", path, options);
  }

  post<P extends PathWith<"post">>(
    path: P,
    options: Typed<Operation<"post", P>>,
  ): Promise<Answer<Operation<"post", P>>> {
    return this.#call("POST", path, options);
  }

  patch<P extends PathWith<"patch">>(
    path: P,
    options: Typed<Operation<"patch", P>>,
  ): Promise<Answer<Operation<"patch", P>>> {
    return this.#call("PATCH", path, options);
  }

  delete<P extends PathWith<"delete">>(
    path: P,
    options: Typed<Operation<"delete", P>>,
  ): Promise<Answer<Operation<"delete", P>>> {
    const query: Record<string, unknown> = (options as Options | undefined)?.query ?? {};
    const empty = Object.keys(query).filter((name) => [null, undefined, ""].includes(query[name] as null));
    if (empty.length) {
      // Left out, a filter without a value would have more deleted.
      const detail = `${empty.join(", ")} has no value; leave it out to delete without it`;
      return Promise.reject(new Problem(0, { title: "Nothing was sent", detail }));
    }
    return this.#call("DELETE", path, options);
  }

  /** Any request by its address, for images and files; gives the response once its headers are there. */
  async send(method: string, path: string, options: Options = {}): Promise<Response> {
    const { query = {}, json = null, type = json === null ? null : "application/json", signal = null } = options;
    const headers = this.headers();
    if (type !== null) headers["Content-Type"] = type;
    const { idempotencyKey = null } = options;
    if (idempotencyKey !== null) headers["Idempotency-Key"] = keyed(idempotencyKey);
    const whole = checked(this.#url + address(path, query));
    const body = options.body ?? (json === null ? null : JSON.stringify(json));
    // A stream is sent while it is read, which fetch wants to be told; its types do not know that yet.
    const stream = body instanceof ReadableStream ? { duplex: "half" } : {};
    let response: Response;
    try {
      response = await (this.#settings.fetch ?? fetch)(whole, {
        method,
        headers,
        signal,
        body,
        credentials: "omit",
        ...stream,
      });
    } catch (error) {
      if (isAborted(error, signal)) throw error;
      throw Problem.silence();
    }
    if (response.ok) return response;
    const problem = await Problem.of(response);
    signal?.throwIfAborted(); // while the problem was read
    throw problem;
  }

  async #call<T>(method: string, path: string, options: Options & { path?: unknown } = {}): Promise<T> {
    const values = (options.path ?? {}) as Record<string, unknown>;
    const filled = path.replace(/\{(\w+)\}/g, (_, name: string) => part(String(values[name])));
    const response = await this.send(method, filled, options);
    try {
      return (await response.json()) as T;
    } catch (error) {
      if (isAborted(error, options.signal)) throw error;
      throw Problem.silence("the answer broke off, or is not of revisit; is there a proxy between?");
    }
  }
}

/** Whether a call failed because its signal aborted it: with whatever reason, a time that is over among them. */
function isAborted(error: unknown, signal?: AbortSignal | null): boolean {
  return Boolean(signal?.aborted) || (error instanceof DOMException && error.name === "AbortError");
}

/** One part of a path. fetch makes another address of "." and "..": /maps/campus/unknown/.. is the map. */
function part(value: string): string {
  if (["", ".", ".."].includes(value) || /\p{Surrogate}/u.test(value)) {
    throw new Problem(0, { title: "Nothing was sent", detail: `${JSON.stringify(value)} is no name and no id` });
  }
  return encodeURIComponent(value);
}

/** An Idempotency-Key; throws a Problem for one that no header carries, or that the service would refuse. */
function keyed(key: string): string {
  if (/^[!-~]{1,255}$/.test(key)) return key;
  const detail = "an Idempotency-Key needs 1 to 255 visible ASCII characters";
  throw new Problem(0, { title: "Nothing was sent", detail });
}

/** The address of a request; throws a Problem for what is none, which fetch takes for a service that is away. */
function checked(whole: string): string {
  try {
    if (/^https?:$/.test(new URL(whole, globalThis.location?.href).protocol)) return whole;
  } catch {
    // told below
  }
  const detail = `${whole} is no address of a service: it needs a scheme, http or https, and a host`;
  throw new Problem(0, { title: "Nothing was sent", detail });
}

/** Seconds that a Retry-After names: a number, or the date of a proxy; null where it names none. */
function seconds(named: string | null): number | null {
  const given = Number(named ?? NaN);
  const left = Number.isNaN(given) ? (Date.parse(named ?? "") - Date.now()) / 1000 : given;
  return Number.isNaN(left) ? null : Math.max(0, left) || null;
}

function form(image: Blob): FormData {
  const sent = new FormData();
  sent.append("image", image, "name" in image ? String(image.name) : "image");
  return sent;
}
