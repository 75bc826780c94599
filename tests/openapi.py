"""Checks every answer against the OpenAPI document: status, media type, headers and schema."""

import re
from typing import Any

import httpx
from fastapi import FastAPI
from fastapi.testclient import TestClient
from jsonschema import Draft202012Validator, FormatChecker

from app.console.files import files
from app.http.problems import shape_of
from schemas.values import moment

_FORMATS = FormatChecker(())


@_FORMATS.checks("date-time", raises=ValueError)  # type: ignore[untyped-decorator]
def _is_moment(value: object) -> bool:
    return not isinstance(value, str) or bool(moment(value))


UNDOCUMENTED = ("/docs", "/openapi.json", *files())


class Contract:
    """An application's OpenAPI document, as a judge of answers."""

    def __init__(self, app: FastAPI) -> None:
        self.document = app.openapi()
        self._patterns = [
            (re.compile(re.sub(r"\{[^/]+\}", "[^/]+", path.replace("{subject}", ".+"))), path)  # it may have slashes
            for path in self.document["paths"]
        ]

    def check(self, response: httpx.Response) -> None:
        """Raise AssertionError when an answer is not what the document promises."""
        method = response.request.method.lower()
        path = response.request.url.path
        path = path.removesuffix("/") or path
        assert response.headers.get("x-request-id"), f"{method} {path} has no X-Request-Id"
        if response.status_code == 405 or path in UNDOCUMENTED:
            return
        template = next((t for pattern, t in self._patterns if pattern.fullmatch(path)), None)
        if template is None:
            assert response.status_code == 404, f"{method} {path} is not documented"
            self._shape({"$ref": f"#/components/schemas/{shape_of(path).__name__}"}, response.json())
            return
        promised = self.document["paths"][template][method]["responses"].get(str(response.status_code))
        assert promised is not None, f"{method} {template} does not promise {response.status_code}: {response.text}"
        self._headers(promised, response)
        self._content(promised, response)

    def _headers(self, promised: dict[str, Any], response: httpx.Response) -> None:
        for name, header in promised.get("headers", {}).items():
            assert not header.get("required") or name in response.headers, f"{name} is missing"

    def _content(self, promised: dict[str, Any], response: httpx.Response) -> None:
        media_type = response.headers.get("content-type", "").partition(";")[0]
        if not promised.get("content"):
            assert not response.content
            return
        assert media_type in promised["content"], f"{media_type} is not among {list(promised['content'])}"
        if media_type.endswith("json"):
            self._shape(promised["content"][media_type]["schema"], response.json())

    def _shape(self, schema: dict[str, Any], value: object) -> None:
        whole = {**schema, "components": self.document["components"]}
        Draft202012Validator(whole, format_checker=_FORMATS).validate(value)


_contracts: list[Contract] = []


def _contract(app: FastAPI) -> Contract:
    """Made once: every application promises the same, and promising takes 0.2 s."""
    if not _contracts:
        _contracts.append(Contract(app))
    return _contracts[0]


class CheckedClient(TestClient):
    """A TestClient that trusts no answer."""

    def __init__(self, app: FastAPI, **options: Any) -> None:
        super().__init__(app, raise_server_exceptions=False, **options)
        self._contract = _contract(app)

    def request(self, *args: Any, **kwargs: Any) -> Any:
        """Send, and check what came back."""
        response = super().request(*args, **kwargs)
        self._contract.check(response)
        return response
