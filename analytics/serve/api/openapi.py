"""The OpenAPI document of the API, written from its operations."""

import importlib.metadata
import re
from collections.abc import Sequence
from typing import Any

import msgspec

from analytics.serve.api.encoding import Form
from analytics.serve.api.endpoint import forms_of
from analytics.serve.api.operation import UNFINISHED, Operation

_PARAMETER = re.compile(r"\{(\w+)\}")
_REF = "#/components/schemas/{name}"
_ERROR = {
    "type": "object",
    "required": ["error"],
    "properties": {
        "error": {
            "type": "object",
            "required": ["kind", "message"],
            "properties": {"kind": {"type": "string"}, "message": {"type": "string"}},
        }
    },
}
_REFUSALS = {
    "400": "A parameter or a statement is not right.",
    "401": "Nobody is known by this token or session.",
    "403": "The role is not enough.",
    "404": "There is no such unit, run or signal; the message names similar ones.",
    "406": "The answer does not come in the form that Accept asks for.",
    "422": "There is not enough data.",
    "429": "Too many requests; Retry-After says when to try again.",
    "503": "The store cannot be read now.",
}


_OF_CHANGES = {
    "409": "It needs a confirmation, or something else is in its way; a station refused it, or has not answered.",
    "413": "The body has more than 1 MiB.",
}
_STREAM: dict[str, Any] = {
    "get": {
        "operationId": "live",
        "summary": "Changes of the floor as server-sent events.",
        "description": "First the event floor, the document of /api/floor, then each change. Needs the role viewer.",
        "parameters": [{"name": "Last-Event-ID", "in": "header", "required": False, "schema": {"type": "string"}}],
        "responses": {"200": {"description": "Events, until it is closed.", "content": {"text/event-stream": {}}}},
    }
}
_PERSON: dict[str, Any] = {
    "get": {
        "operationId": "me",
        "summary": "Who asks: name, role, and the token that changes of a session need.",
        "description": "Needs the role viewer.",
        "parameters": [],
        "responses": {
            "200": {
                "description": "Who asks.",
                "content": {
                    "application/json": {
                        "schema": {
                            "type": "object",
                            "required": ["name", "role", "csrf"],
                            "properties": {
                                "name": {"type": "string"},
                                "role": {"type": "string"},
                                "csrf": {"type": ["string", "null"]},
                            },
                        }
                    }
                },
            }
        },
    }
}


def openapi_document(operations: Sequence[Operation[Any, Any]]) -> dict[str, Any]:
    """The document of these operations."""
    types = [each.asked for each in operations] + [each.answer for each in operations]
    schemas, components = msgspec.json.schema_components(types, ref_template=_REF)
    asked, answers = schemas[: len(operations)], schemas[len(operations) :]
    paths: dict[str, dict[str, Any]] = {}
    for operation, of_asked, of_answer in zip(operations, asked, answers, strict=True):
        paths.setdefault(operation.path.replace(":path}", "}"), {})[operation.method.lower()] = _operation(
            operation, of_asked, of_answer, components
        )
    error = {"application/json": {"schema": {"$ref": _REF.format(name="Error")}}}
    refused = {status: {"description": _REFUSALS[status], "content": error} for status in ("401", "403", "429")}
    for path, found in (("/api/live", _STREAM), ("/api/me", _PERSON)):
        paths[path] = {"get": found["get"] | {"responses": found["get"]["responses"] | refused}}
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "gyrofleet",
            "version": importlib.metadata.version("gyrofleet"),
            "description": "What a store of gyrofleet knows. Times are UTC: names in _ns are nanoseconds since 1970, "
            "the same name without it is ISO 8601. Values carry their unit_of_measure.",
        },
        "servers": [{"url": "/"}],
        "security": [{"token": []}, {"session": []}],
        "paths": paths,
        "components": {
            "schemas": components | {"Error": _ERROR},
            "securitySchemes": {
                "token": {"type": "http", "scheme": "bearer"},
                "session": {
                    "type": "apiKey",
                    "in": "cookie",
                    "name": "gyrofleet_PORT",
                    "description": "After /login; changes need the header X-CSRF-Token as well.",
                },
            },
        },
    }


def _operation(
    operation: Operation[Any, Any], asked: dict[str, Any], answer: dict[str, Any], components: dict[str, Any]
) -> dict[str, Any]:
    parameters: list[dict[str, Any]] = [
        {"name": name, "in": "path", "required": True, "schema": {"type": "string"}}
        for name in _PARAMETER.findall(operation.path.replace(":path}", "}"))
    ]
    found: dict[str, Any] = {
        "operationId": operation.name,
        "summary": operation.about.splitlines()[0],
        "description": f"Needs the role {operation.role.word}.",
        "parameters": parameters,
    }
    forms = list(Form) if operation.method == "POST" and "format" in _fields(asked, components) else forms_of(operation)
    if operation.method == "GET":
        required = components[asked["$ref"].rpartition("/")[2]].get("required", ())
        for name, schema in _fields(asked, components).items():
            parameters.append({"name": name, "in": "query", "required": name in required, "schema": schema})
        if len(forms) > 1:
            chosen = {"type": "string", "enum": [each.value for each in forms]}
            parameters.append({"name": "format", "in": "query", "required": False, "schema": chosen})
    else:
        found["requestBody"] = {"required": True, "content": {"application/json": {"schema": asked}}}
    content: dict[str, Any] = (
        {operation.media_type: {}}
        if operation.media_type
        else {each.media_type.partition(";")[0]: {"schema": answer if each is Form.JSON else {}} for each in forms}
    )
    found["responses"] = {str(operation.status): {"description": operation.about, "content": content}}
    if operation.is_unfinished is not None:
        found["responses"][str(UNFINISHED)] = {
            "description": "It goes on: the text says how to see its end.",
            "content": content,
        }
    if operation.is_kept:
        found["responses"]["304"] = {"description": "As the ETag of the request says."}
    error = {"application/json": {"schema": {"$ref": _REF.format(name="Error")}}}
    refusals = _REFUSALS | (_OF_CHANGES if operation.method == "POST" else {})
    found["responses"] |= {status: {"description": text, "content": error} for status, text in refusals.items()}
    return found


def _fields(schema: dict[str, Any], components: dict[str, Any]) -> dict[str, Any]:
    """Fields of a structure in the document."""
    properties: dict[str, Any] = components[schema["$ref"].rpartition("/")[2]].get("properties", {})
    return properties
