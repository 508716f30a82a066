"""docs/report.schema.json matches imumon.model.report; ``python tests/test_report_schema.py`` writes it."""

from __future__ import annotations

import inspect
import json
import re
import types
import typing
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Literal

import pytest
from paths import ROOT

from imumon.model import report
from imumon.model.coefficients import COEFFICIENTS
from imumon.model.filter_report import FILTER_SCHEMA, FilterReport
from imumon.model.report import Channel, Event, Report, Signal, from_json
from imumon.model.report_json import to_json
from imumon.model.samples import GYRO, ChannelName

DOCS = ROOT / "docs"
FILE = DOCS / "report.schema.json"
FILTER_FILE = DOCS / "filter.schema.json"
OMITTED = ("allan", "histogram", "spectrum", "convergence")  # of a channel on its own key
PLAIN: dict[Any, str] = {
    str: "string",
    ChannelName: "string",
    int: "integer",
    float: "number",
    bool: "boolean",
}


def schema() -> dict[str, Any]:
    """Return the JSON Schema of a report and the other messages, from the dataclasses and their comments."""
    about = (
        "imumon/{id}/report; Channel is imumon/{id}/{sensor}/{axis}, Grade imumon/{id}/grade, "
        "Event imumon/{id}/event, Signal imumon/{id}/signal/{sensor}/{axis}. Fields may be added."
    )
    made = document(report.SCHEMA, about, Report, Event, Signal)
    grade = shape(typing.get_type_hints(Report)["grade"], made["$defs"])
    grade = {"description": "The report's grade alone: the headline of each sensor.", **grade}
    return made | {"$defs": dict(sorted({**made["$defs"], "Grade": grade}.items()))}


def filter_schema() -> dict[str, Any]:
    """Return the JSON Schema of the parameters for filters."""
    about = "imumon report --format filter (docs/FILTERS.md). Fields may be added."
    return document(FILTER_SCHEMA, about, FilterReport)


def document(title: str, about: str, *classes: type) -> dict[str, Any]:
    """Return the schema of messages, the first of which is that of the document."""
    defs: dict[str, Any] = {}
    for cls in classes:
        define(cls, defs)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": title,
        "description": about,
        "$ref": f"#/$defs/{classes[0].__name__}",
        "$defs": dict(sorted(defs.items())),
    }


def define(cls: type, defs: dict[str, Any]) -> dict[str, Any]:
    if cls.__name__ not in defs:
        defs[cls.__name__] = {}  # keeps the order
        hints, notes = typing.get_type_hints(cls), comments(cls)
        properties = {}
        for field in fields(cls):
            name, hint = field.name, hints[field.name]
            note = {"description": notes[name]} if name in notes else {}
            if entries := field.metadata.get("entries"):
                always, inner = field.default_factory(), typing.get_args(hint)[1]
                for letter in entries:
                    known = shape(inner if letter in always else inner | None, defs)
                    properties[letter] = known | {
                        "description": f"{COEFFICIENTS[letter].about}; {notes[name]}"
                    }
            elif keys := field.metadata.get("keys"):
                inner = shape(typing.get_args(typing.get_args(hint)[0])[1], defs)
                own = {letter: inner | {"description": COEFFICIENTS[letter].about} for letter in keys}
                kind = {"type": ["object", "null"], "properties": own, "required": list(keys)}
                properties[name] = kind | note
            else:
                properties[name] = shape(hint, defs) | note
        for name, members in getattr(cls, "DERIVED", {}).items():
            own = {member: properties[member] for member in members}
            note = {"description": inspect.getdoc(getattr(cls, name))}
            properties[name] = {"type": "object", "properties": own, "required": list(own)} | note
        required = [name for name in properties if not (cls is Channel and name in OMITTED)]
        about = (inspect.getdoc(cls) or "").split("\n\n")[0].replace("\n", " ")
        described = {"description": about} if not about.startswith(cls.__name__ + "(") else {}
        defs[cls.__name__] = {"type": "object", **described, "properties": properties, "required": required}
    return {"$ref": f"#/$defs/{cls.__name__}"}


def comments(cls: type) -> dict[str, str]:
    """Return the comments of the fields in the source, beside them or on the line above."""
    source = inspect.getsource(cls)
    above = re.findall(r"^    #\s*(.+)\n    (\w+):", source, re.MULTILINE)
    beside = re.findall(r"^    (\w+): [^#\n]*#\s*(.+)$", source, re.MULTILINE)
    return {name: text for text, name in above} | dict(beside)


def shape(hint: Any, defs: dict[str, Any]) -> dict[str, Any]:
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        inner = shape(arguments[0], defs)
        if "enum" in inner:
            return {"enum": [*inner["enum"], None]}
        if isinstance(inner.get("type"), str):
            return inner | {"type": [inner["type"], "null"]}
        return {"anyOf": [inner, {"type": "null"}]}
    if origin is Literal:
        return {"enum": list(arguments)}
    if origin is tuple:
        return {"type": "array", "items": shape(arguments[0], defs)}
    if origin is Mapping:
        return {"type": "object", "additionalProperties": shape(arguments[1], defs)}
    return define(hint, defs) if is_dataclass(hint) else {"type": PLAIN[hint]}


def filled(hint: Any, *, empty: bool) -> Any:
    """Return a value of this type, with every optional part, or with none."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        inner = arguments[0]
        return None if empty else filled(inner, empty=False)
    if origin is Literal:
        return arguments[-1]
    if origin is tuple:
        return () if empty else (filled(arguments[0], empty=False),) * 2
    if origin is Mapping:
        return {} if empty else {arguments[0]("gyro/x"): filled(arguments[1], empty=False)}
    if is_dataclass(hint):
        hints = typing.get_type_hints(hint)
        parts = {f.name: filled(hints[f.name], empty=empty) for f in fields(hint)}
        for field in fields(hint):
            if entries := field.metadata.get("entries"):
                inner = typing.get_args(hints[field.name])[1]
                full = {letter: filled(inner, empty=empty) for letter in entries}
                parts[field.name] = field.default_factory() if empty else full
            elif (keys := field.metadata.get("keys")) and not empty:
                parts[field.name] = dict.fromkeys(keys, 0.1)
        if parts.get("channel"):
            parts["channel"] = "gyro/x"
        return hint(**parts)
    return {str: "°/√h", ChannelName: GYRO[0], int: 3, float: 0.1, bool: True}[hint]


SCHEMAS = {FILE: schema, FILTER_FILE: filter_schema}


@pytest.mark.parametrize("file", SCHEMAS, ids=lambda file: file.name)
def test_the_schema_file_matches_the_code_and_describes_every_message_and_field(file: Path) -> None:
    written = json.loads(file.read_text("utf-8"))
    assert written == SCHEMAS[file](), "run python tests/test_report_schema.py"
    for name, rule in written["$defs"].items():
        assert rule.get("description"), name
        for field, each in rule.get("properties", {}).items():
            assert each.get("description"), f"{name}.{field}"


@pytest.mark.parametrize("cls", [Report, Event, Signal, FilterReport])
@pytest.mark.parametrize("empty", [True, False])
def test_every_message_survives_json(cls: type, empty: bool) -> None:
    message = filled(cls, empty=empty)
    assert from_json(cls, to_json(message)) == message


def test_a_channel_on_its_own_key_has_no_curves() -> None:
    entry = {k: v for k, v in json.loads(to_json(filled(Channel, empty=False))).items() if k not in OMITTED}
    assert from_json(Channel, json.dumps(entry)).allan is None


@pytest.mark.parametrize(
    ("part", "name"),
    [("Allan", "edf"), ("Histogram", "gaussian"), ("Spectrum", "averages"), ("Strip", "high")],
)
def test_parallel_arrays_of_different_lengths_are_refused(part: str, name: str) -> None:
    cls = getattr(report, part)
    data = json.loads(to_json(filled(cls, empty=False)))
    assert from_json(cls, json.dumps(data))
    with pytest.raises(ValueError, match="different lengths"):
        from_json(cls, json.dumps(data | {name: data[name][:1]}))
    del data[name]
    with pytest.raises(ValueError, match=r"imumon\.report/1"):
        from_json(cls, json.dumps(data))


def test_text_that_is_read_has_no_control_characters() -> None:
    data = json.loads(to_json(filled(Report, empty=False)))
    data["device"]["model"] = "VN\x1b[2J-100\u202e °\ud800"
    data["device"]["settings"] = {"a\x07": "b\r\n"}
    read = from_json(Report, json.dumps(data)).device
    assert (read.model, read.settings) == ("VN[2J-100 °", {"a": "b"})


if __name__ == "__main__":
    for file, made in SCHEMAS.items():
        file.write_text(json.dumps(made(), indent=1, ensure_ascii=False) + "\n", "utf-8")
