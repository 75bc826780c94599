"""Make the client's types and the console's copy of it: ``python client/typescript/generate.py``.

The types come from the service's OpenAPI document by openapi-typescript, the console's ``revisit.js`` from
``revisit.ts`` by the TypeScript compiler; both at the versions of package-lock.json, which npm installs into this
folder. Each file begins with the SHA-256 of what it was made from, so that a test without npm finds out when it is old.
"""

import hashlib
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
SOURCE = HERE / "src" / "revisit.ts"
TYPES = HERE / "src" / "openapi.d.ts"
SERVED = ROOT / "app" / "console" / "static" / "revisit.js"


def reduced(document: dict[str, Any]) -> dict[str, Any]:
    """The part of the OpenAPI document that types need: errors have one shape, and bodies of images are forms."""
    paths = {
        path: {method: _reduced(operation) for method, operation in methods.items()}
        for path, methods in document["paths"].items()
    }
    return {"openapi": document["openapi"], "info": {"title": "revisit", "version": "0"}, "paths": paths} | {
        "components": {"schemas": document["components"]["schemas"]}
    }


def _reduced(operation: dict[str, Any]) -> dict[str, Any]:
    kept = {name: operation[name] for name in ("operationId", "description", "parameters") if name in operation}
    body = operation.get("requestBody", {})
    if "application/json" in body.get("content", {}):
        kept["requestBody"] = body | {"content": {"application/json": body["content"]["application/json"]}}
    answers = {status: answer for status, answer in operation["responses"].items() if status.startswith("2")}
    return kept | {"responses": answers}


def digest(text: str) -> str:
    """SHA-256 of a text."""
    return hashlib.sha256(text.encode()).hexdigest()


def digest_of_types(document: dict[str, Any]) -> str:
    """What `TYPES` begins with when it was made from this document."""
    return digest(json.dumps(reduced(document), sort_keys=True))


def header(digest: str) -> str:
    """First line of a file that is made, with the SHA-256 of what it is made from."""
    return f"// By client/typescript/generate.py, from {digest}\n"


def types(document: dict[str, Any], folder: Path) -> str:
    """The types of a document; `folder` for files in between."""
    (folder / "openapi.json").write_text(json.dumps(reduced(document)))
    _run("openapi-typescript", folder / "openapi.json", "-o", folder / "openapi.d.ts")
    return header(digest_of_types(document)) + (folder / "openapi.d.ts").read_text()


def served(folder: Path) -> str:
    """The client as the console loads it; `folder` for files in between. Fails where the types do not fit."""
    _run("tsc", "--project", HERE, "--outDir", folder)
    return header(digest(SOURCE.read_text())) + (folder / "revisit.js").read_text()


def _run(program: str, *arguments: str | Path) -> None:
    subprocess.run([HERE / "node_modules" / ".bin" / program, *arguments], check=True, stdout=sys.stderr)


def main() -> None:
    """Make both files."""
    sys.path.insert(0, str(ROOT))
    from app.http.application import create_app
    from schemas.settings import Settings
    from worker.runtime import build

    subprocess.run(["npm", "ci", "--no-audit", "--no-fund"], cwd=HERE, check=True, stdout=sys.stderr)
    with tempfile.TemporaryDirectory() as folder:
        runtime = build(Settings(data=Path(folder), encoder="color"))
        TYPES.write_text(types(create_app(runtime).openapi(), Path(folder)))
        SERVED.write_text(served(Path(folder)))


if __name__ == "__main__":
    main()
