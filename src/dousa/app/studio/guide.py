"""The page that describes the interface for programs: every address with a call that can be copied."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

__all__ = ["Operation", "describe_interface"]


@dataclass(frozen=True, slots=True)
class Operation:
    """One address of the interface.

    Parameters
    ----------
    tag, method, path, summary, description : as the description of the interface (OpenAPI) says.
    fields : (name, type, whether it must be given, what it is) of query and body.
    call : a line for the shell; ``$URL`` and ``$TOKEN`` stand for address and token.
    """

    tag: str
    method: str
    path: str
    summary: str
    description: str
    fields: tuple[tuple[str, str, bool, str], ...]
    call: str


def describe_interface(openapi: Mapping[str, Any]) -> dict[str, list[Operation]]:
    """All operations by topic, in the order of the description.

    Parameters
    ----------
    openapi : description of the interface, as ``FastAPI.openapi`` makes it.
    """
    schemas = openapi.get("components", {}).get("schemas", {})
    found: dict[str, list[Operation]] = {}
    for path, methods in openapi["paths"].items():
        for method, said in methods.items():
            operation = _describe(path, method.upper(), said, schemas)
            found.setdefault(operation.tag, []).append(operation)
    return found


def _describe(path: str, method: str, said: Mapping[str, Any], schemas: Mapping[str, Any]) -> Operation:
    fields = [
        (one["name"], _type(one["schema"]), bool(one.get("required")), _words(one, one["schema"]))
        for one in said.get("parameters", ())
    ]
    content = said.get("requestBody", {}).get("content", {})
    body = content.get("application/json", {}).get("schema")
    schema = {} if body is None else _follow(body, schemas)
    needed = schema.get("required", ())
    fields += [
        (name, _type(one), name in needed, _words(one)) for name, one in schema.get("properties", {}).items()
    ]
    return Operation(
        tag=(said.get("tags") or ["general"])[0],
        method=method,
        path=path,
        summary=said.get("summary", ""),
        description=said.get("description", ""),
        fields=tuple(fields),
        call=_call(path, method, said, schema, schemas, is_file="application/octet-stream" in content),
    )


def _follow(schema: Mapping[str, Any], schemas: Mapping[str, Any]) -> Mapping[str, Any]:
    return schemas[schema["$ref"].rpartition("/")[2]] if "$ref" in schema else schema


def _type(schema: Mapping[str, Any]) -> str:
    if "$ref" in schema:
        return str(schema["$ref"].rpartition("/")[2])
    if "enum" in schema or "const" in schema:
        return " | ".join(str(value) for value in schema.get("enum", [schema.get("const")]))
    if "anyOf" in schema:
        return " | ".join(_type(one) for one in schema["anyOf"])
    if schema.get("type") == "array":
        return f"list of {_type(schema.get('items', {}))}"
    return str(schema.get("type", "any"))


def _words(*places: Mapping[str, Any]) -> str:
    return next((str(place["description"]) for place in places if place.get("description")), "")


def _call(
    path: str,
    method: str,
    said: Mapping[str, Any],
    schema: Mapping[str, Any],
    schemas: Mapping[str, Any],
    *,
    is_file: bool,
) -> str:
    query = "&".join(
        f"{one['name']}={_example(one['schema'], schemas, one['name'])}"
        for one in said.get("parameters", ())
        if one["in"] == "query" and one.get("required")
    )
    for one in said.get("parameters", ()):
        if one["in"] == "path":
            path = path.replace(f"{{{one['name']}}}", one["name"].upper())
    words = ['curl -H "Authorization: Bearer $TOKEN"']
    if method not in ("GET", "POST") or (method == "POST" and not schema and not is_file):
        words.append(f"-X {method}")
    if is_file:
        words.append("--data-binary @walk.bvh")
    if schema:
        body = {
            name: _example(one, schemas, name)
            for name, one in schema.get("properties", {}).items()
            if name in schema.get("required", ())
        }
        words.append(f"--json {shlex.quote(json.dumps(body))}")
    words.append(f'"$URL{path}{"?" + query if query else ""}"')
    return " ".join(words)


_EXAMPLES = {
    "name": "kick/walk.bvh",
    "clips": [1, 2],
    "batch": "BATCH",
    "category": "kick",
    "start_s": 1.5,
    "end_s": 2.5,
}


def _example(schema: Mapping[str, Any], schemas: Mapping[str, Any], name: str = "") -> Any:
    schema = _follow(schema, schemas)
    known = [*schema.get("examples", ()), *([_EXAMPLES[name]] if name in _EXAMPLES else ())]
    known += [*([schema["default"]] if "default" in schema else ()), *schema.get("enum", ())]
    if known:
        return known[0]
    if "anyOf" in schema:
        return _example(schema["anyOf"][0], schemas, name)
    if schema.get("type") == "object":
        needed = schema.get("required", ())
        parts = schema.get("properties", {}).items()
        return {key: _example(one, schemas, key) for key, one in parts if key in needed}
    if schema.get("type") == "array":
        return [_example(schema.get("items", {}), schemas, name)]
    return {"integer": 1, "number": 1.0, "boolean": True}.get(str(schema.get("type")), name.upper())
