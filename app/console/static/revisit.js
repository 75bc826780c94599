// By client/typescript/generate.py, from 62e427ed983ad83edb8c9192113ebd9f0ee0e7999352b1380ee59e1ceb5c9159
// A client of revisit over HTTP. Its types are those of the service's OpenAPI document (openapi.d.ts, generated).
//
//   const revisit = new Revisit(address, { key });
//   const answer = await revisit.query(photo, { map: "campus" });
//   if (answer.status === "matched") console.log(answer.places[0].place, answer.confidence);
/** An error of the service (RFC 9457); `status` is 0 where there was no answer. */
export class Problem extends Error {
    status;
    /** The last part of `type`, as docs/errors.md lists them. */
    code;
    title;
    detail;
    errors;
    requestId;
    /** Seconds after which to try again. */
    retryAfter;
    constructor(status, body, retryAfter = null) {
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
    static async of(response) {
        const retry = seconds(response.headers.get("Retry-After"));
        try {
            return new Problem(response.status, (await response.json()), retry);
        }
        catch {
            const detail = "the answer was no problem+json; is there a proxy between?";
            return new Problem(response.status, { title: `Status ${response.status}`, detail }, retry);
        }
    }
    /** That no answer came. */
    static silence(detail = "the service cannot be reached; is it running?") {
        return new Problem(0, { title: "No answer", detail });
    }
}
/** A path with parameters; those that are null, undefined or "" are left out. */
export function address(path, query = {}) {
    const given = Object.entries(query).filter(([, value]) => value !== null && value !== undefined && value !== "");
    return given.length ? `${path}?${new URLSearchParams(given.map(([name, value]) => [name, String(value)]))}` : path;
}
/** A service. Every call rejects with a Problem, or as fetch does when its signal aborts it. */
export class Revisit {
    #url;
    #settings;
    /** `url`: where the service is, without a slash at the end; "" for that of the page. */
    constructor(url = "", settings = {}) {
        this.#url = url;
        this.#settings = settings;
    }
    /** Headers that carry the key, if there is one; throws a Problem for what can be none. */
    headers() {
        const { key } = this.#settings;
        const given = (typeof key === "function" ? key() : key)?.trim();
        if (given && !/^[!-~]+$/.test(given)) {
            const detail = "the key has letters that no key has; take it as `./revisit keys create` printed it";
            throw new Problem(0, { title: "Nothing was sent", detail });
        }
        return given ? { "X-Api-Key": given } : {};
    }
    /** Which views of a map, or of several, show the place of this image? */
    query(image, query = {}, sending = {}) {
        return this.#call("POST", "/query", { ...sending, query, body: form(image) });
    }
    /** Enrol an image: 201 once it can be found, 202 where that will take longer. */
    enroll(image, query = {}, sending = {}) {
        return this.#call("POST", "/enroll", { ...sending, query, body: form(image) });
    }
    get(path, options) {
        return this.#call("GET", path, options);
    }
    put(path, options) {
        return this.#call("PUT", path, options);
    }
    post(path, options) {
        return this.#call("POST", path, options);
    }
    patch(path, options) {
        return this.#call("PATCH", path, options);
    }
    delete(path, options) {
        const query = options?.query ?? {};
        const empty = Object.keys(query).filter((name) => [null, undefined, ""].includes(query[name]));
        if (empty.length) {
            // Left out, a filter without a value would have more deleted.
            const detail = `${empty.join(", ")} has no value; leave it out to delete without it`;
            return Promise.reject(new Problem(0, { title: "Nothing was sent", detail }));
        }
        return this.#call("DELETE", path, options);
    }
    /** Any request by its address, for images and files; gives the response once its headers are there. */
    async send(method, path, options = {}) {
        const { query = {}, json = null, type = json === null ? null : "application/json", signal = null } = options;
        const headers = this.headers();
        if (type !== null)
            headers["Content-Type"] = type;
        const { idempotencyKey = null } = options;
        if (idempotencyKey !== null)
            headers["Idempotency-Key"] = keyed(idempotencyKey);
        const whole = checked(this.#url + address(path, query));
        const body = options.body ?? (json === null ? null : JSON.stringify(json));
        // A stream is sent while it is read, which fetch wants to be told; its types do not know that yet.
        const stream = body instanceof ReadableStream ? { duplex: "half" } : {};
        let response;
        try {
            response = await (this.#settings.fetch ?? fetch)(whole, {
                method,
                headers,
                signal,
                body,
                credentials: "omit",
                ...stream,
            });
        }
        catch (error) {
            if (isAborted(error, signal))
                throw error;
            throw Problem.silence();
        }
        if (response.ok)
            return response;
        const problem = await Problem.of(response);
        signal?.throwIfAborted(); // while the problem was read
        throw problem;
    }
    async #call(method, path, options = {}) {
        const values = (options.path ?? {});
        const filled = path.replace(/\{(\w+)\}/g, (_, name) => part(String(values[name])));
        const response = await this.send(method, filled, options);
        try {
            return (await response.json());
        }
        catch (error) {
            if (isAborted(error, options.signal))
                throw error;
            throw Problem.silence("the answer broke off, or is not of revisit; is there a proxy between?");
        }
    }
}
/** Whether a call failed because its signal aborted it: with whatever reason, a time that is over among them. */
function isAborted(error, signal) {
    return Boolean(signal?.aborted) || (error instanceof DOMException && error.name === "AbortError");
}
/** One part of a path. fetch makes another address of "." and "..": /maps/campus/unknown/.. is the map. */
function part(value) {
    if (["", ".", ".."].includes(value) || /\p{Surrogate}/u.test(value)) {
        throw new Problem(0, { title: "Nothing was sent", detail: `${JSON.stringify(value)} is no name and no id` });
    }
    return encodeURIComponent(value);
}
/** An Idempotency-Key; throws a Problem for one that no header carries, or that the service would refuse. */
function keyed(key) {
    if (/^[!-~]{1,255}$/.test(key))
        return key;
    const detail = "an Idempotency-Key needs 1 to 255 visible ASCII characters";
    throw new Problem(0, { title: "Nothing was sent", detail });
}
/** The address of a request; throws a Problem for what is none, which fetch takes for a service that is away. */
function checked(whole) {
    try {
        if (/^https?:$/.test(new URL(whole, globalThis.location?.href).protocol))
            return whole;
    }
    catch {
        // told below
    }
    const detail = `${whole} is no address of a service: it needs a scheme, http or https, and a host`;
    throw new Problem(0, { title: "Nothing was sent", detail });
}
/** Seconds that a Retry-After names: a number, or the date of a proxy; null where it names none. */
function seconds(named) {
    const given = Number(named ?? NaN);
    const left = Number.isNaN(given) ? (Date.parse(named ?? "") - Date.now()) / 1000 : given;
    return Number.isNaN(left) ? null : Math.max(0, left) || null;
}
function form(image) {
    const sent = new FormData();
    sent.append("image", image, "name" in image ? String(image.name) : "image");
    return sent;
}
