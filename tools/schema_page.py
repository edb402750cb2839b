"""Write docs/calibration-json.md from the schema of calibration.json: `tools/schema_page.py`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from calib.document.calibration import Document

PAGE = Path(__file__).parents[1] / "docs" / "calibration-json.md"

HEAD = """# calibration.json

Written from the schema by `tools/schema_page.py`; `calib schema calibration` prints the schema
itself, for programs and editors. Lengths are mm, angles rad, covariances in the units of what they
are of. Depths (`z_mm`) count from the optical centre of C1, wherever the reference depths of the
table were counted from: `z_from` of `[gaze]` is taken into account. Keys that a dataset has no
data for are absent; an entry `name?` may be.
"""


def page() -> str:
    """Return the page."""
    schema = Document.model_json_schema(by_alias=True)
    parts = [HEAD, _section("The document", schema)]
    parts += [_section(name, schema["$defs"][name]) for name in _reached(schema)]
    return "\n".join(parts)


def _reached(schema: dict[str, Any]) -> list[str]:
    """Return the names of all sections in the order in which a reader meets them."""
    found: list[str] = []

    def walk(node: Any) -> None:
        if isinstance(node, dict):
            if "$ref" in node:
                name = node["$ref"].rpartition("/")[2]
                if name not in found:
                    found.append(name)
                    walk(schema["$defs"][name])
            for key, value in node.items():
                if key not in ("$defs", "$ref"):
                    walk(value)
        elif isinstance(node, list):
            for value in node:
                walk(value)

    walk(schema)
    return found


def _section(name: str, part: dict[str, Any]) -> str:
    needed = set(part.get("required", ()))
    lines = [f"## {name}", "", part.get("description", "").split("\n\n")[0].replace("\n", " "), ""]
    lines += ["| key | type | meaning |", "|---|---|---|"]
    for key, entry in part.get("properties", {}).items():
        mark = "" if key in needed else "?"
        lines.append(f"| `{key}`{mark} | {_kind(entry)} | {entry.get('description', '')} |")
    return "\n".join(lines) + "\n"


def _kind(entry: dict[str, Any]) -> str:
    """Return the type of an entry in words, with links to sections."""
    if "$ref" in entry:
        name = entry["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "anyOf" in entry:
        kinds = dict.fromkeys(_kind(e) for e in entry["anyOf"] if e.get("type") != "null")
        null = " or null" if any(e.get("type") == "null" for e in entry["anyOf"]) else ""
        # Where a key may be left out, null stands for that and is not written.
        return " or ".join(kinds) + ("" if entry.get("default", 0) is None else null)
    values = [entry["const"]] if "const" in entry else entry.get("enum")
    if values is not None:
        return ", ".join(f"`{value}`" for value in values)
    return _collection(entry) or str(entry.get("type", "anything"))


def _collection(entry: dict[str, Any]) -> str:
    """Return the type of a list or object in words; empty for any other."""
    if "prefixItems" in entry:
        return f"{len(entry['prefixItems'])} of {_kind(entry['prefixItems'][0])}"
    if entry.get("type") == "array":
        return f"list of {_kind(entry.get('items', {}))}"
    if isinstance(values := entry.get("additionalProperties"), dict):
        return f"{_kind(values)} by name"
    return ""


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
