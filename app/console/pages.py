"""API documentation as plain HTML that loads nothing from other hosts."""

import json
import re
from collections.abc import Mapping
from html import escape
from operator import itemgetter
from typing import Any

POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src 'self'"
"""Content-Security-Policy: no scripts and nothing from another host, whatever text a map's name contains."""

Json = Mapping[str, Any]

_STYLE = """
body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#1c2330}
h1,h2{line-height:1.2}table{border-collapse:collapse;width:100%;margin:.5rem 0}
td,th{text-align:left;vertical-align:top;padding:.2rem .6rem .2rem 0;border-bottom:1px solid #dde2ea}
td,p,summary{overflow-wrap:anywhere}
code,pre{font:13px/1.45 ui-monospace,monospace;background:#f3f5f8;border-radius:4px}
code{padding:.1rem .3rem}pre{padding:.7rem;overflow:auto}
details{border:1px solid #dde2ea;border-radius:6px;padding:.4rem .8rem;margin:.5rem 0}summary{cursor:pointer}
.m{display:inline-block;min-width:4.2rem;font-weight:700}.quiet{color:#5b6675}
"""

_CURL = """curl -F image=@a.jpg -F place='front door' http://{host}/enroll
curl -F image=@b.jpg http://{host}/query"""


def _page(title: str, body: str) -> str:
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<style>{_STYLE}</style></head><body>{body}</body></html>"
    )


def docs(document: Json, host: str) -> str:
    """The OpenAPI document as one page; `host` is how the reader reaches the service, with the port."""
    by_tag: dict[str, list[tuple[str, str]]] = {}
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            tag = operation.get("tags", ["other"])[0]
            by_tag.setdefault(tag, []).append((path, _operation(method, path, operation)))
    sections = "".join(
        f"<h2>{escape(tag)}</h2>{''.join(item for _, item in sorted(items, key=itemgetter(0)))}"
        for tag, items in by_tag.items()
    )
    info = document["info"]
    intro = _paragraphs(info["description"])
    return _page(
        f"{info['title']} API",
        f"<h1>{escape(info['title'])} API <span class='quiet'>{escape(info['version'])}</span></h1>{intro}"
        f"<pre>{escape(_CURL.format(host=host))}</pre>"
        f"<p>For programs: <a href='/openapi.json'>/openapi.json</a>.</p>{sections}"
        f"<h2>Shapes</h2>{''.join(_shape(n, s) for n, s in sorted(document['components']['schemas'].items()))}",
    )


def _operation(method: str, path: str, operation: Json) -> str:
    what, _, more = operation.get("description", "").partition("\n\n")
    parts = [_paragraphs(more)]
    if parameters := operation.get("parameters"):
        rows = "".join(_parameter(p) for p in parameters)
        parts.append(f"<table><tr><th>parameter</th><th>type</th><th>meaning</th></tr>{rows}</table>")
    if body := operation.get("requestBody"):
        kinds = ", ".join(f"<code>{escape(kind)}</code>" for kind in body["content"])
        parts.append(f"<p>Body: {kinds}</p>")
        parts += [_example(c["example"]) for c in list(body["content"].values())[:1] if "example" in c]
    for status, response in operation["responses"].items():
        content = response.get("content", {}).get("application/json", {})
        shape = _type(content["schema"]) if "schema" in content else ""
        parts.append(f"<p><b>{escape(str(status))}</b> {_text(response.get('description', ''))} {shape}</p>")
        if "example" in content:
            parts.append(_example(content["example"]))
    return (
        f"<details><summary><span class='m'>{method.upper()}</span> <code>{escape(path)}</code> "
        f"<span class='quiet'>{_text(what)}</span></summary>{''.join(parts)}</details>"
    )


def _parameter(parameter: Json) -> str:
    schema = parameter.get("schema", {})
    needed = " <b>required</b>" if parameter.get("required") else ""
    default = f" Default <code>{escape(json.dumps(schema['default']))}</code>." if "default" in schema else ""
    return (
        f"<tr><td><code>{escape(parameter['name'])}</code> <span class='quiet'>{parameter['in']}</span></td>"
        f"<td>{_type(schema)}</td><td>{_text(parameter.get('description', ''))}{default}{needed}</td></tr>"
    )


def _shape(name: str, schema: Json) -> str:
    summary = schema.get("description", "").partition("\n")[0]
    rows = "".join(
        f"<tr><td><code>{escape(field)}</code></td><td>{_type(s)}</td><td>{_text(s.get('description', ''))}</td></tr>"
        for field, s in schema.get("properties", {}).items()
    )
    return (
        f"<details id='{escape(name)}'><summary><code>{escape(name)}</code> "
        f"<span class='quiet'>{_text(summary)}</span></summary><table>{rows}</table></details>"
    )


def _type(schema: Json) -> str:
    """A JSON schema in a few words, with links to other shapes."""
    if "$ref" in schema:
        name = escape(str(schema["$ref"]).rsplit("/", 1)[-1])
        return f"<a href='/docs#{name}'>{name}</a>"
    if branches := schema.get("anyOf"):
        return " or ".join(map(_type, branches))
    if "enum" in schema:
        return escape(" | ".join(map(str, schema["enum"])))
    if schema.get("type") == "array":
        return f"list of {_type(schema.get('items', {}))}"
    bounds = [
        f"{word} {schema[key]:g}"
        for key, word in (("minimum", "≥"), ("maximum", "≤"), ("exclusiveMaximum", "<"))
        if key in schema
    ]
    kind = schema.get("type", "any")
    words = [" | ".join(kind) if isinstance(kind, list) else str(schema.get("format", kind)), *bounds]
    return escape(" ".join(words))


def _paragraphs(text: str) -> str:
    return "".join(f"<p>{_text(part)}</p>" for part in text.split("\n\n") if part)


def _text(text: str) -> str:
    """A description, with what stands in backticks as code."""
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(text))


def _example(value: object) -> str:
    return f"<pre>{escape(json.dumps(value, indent=1, ensure_ascii=False))}</pre>"
