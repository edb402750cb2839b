"""A document that carries the digest of its own content: who edits it by hand is told so."""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import sha256
from typing import Any

KEY = "integrity"

GENERATOR = "generator"
"""Key of the program that wrote a document: it writes none without a digest."""


def content_digest(document: Mapping[str, Any]) -> str:
    """Return the SHA-256, hex, of a JSON document's content but for the digest itself.

    It is that of the compact JSON text with sorted keys: the same for any layout of the file.
    """
    content = {key: value for key, value in document.items() if key != KEY}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return sha256(text.encode()).hexdigest()


def with_digest(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the document with the digest of its content."""
    return {**document, KEY: {"sha256": content_digest(document)}}


def is_edited(document: Mapping[str, Any]) -> bool:
    """Return whether a document is not what its digest is of, or has lost it.

    One that names no generator was not written by this program, and need not carry a digest.
    """
    stated = document.get(KEY)
    if stated is None:
        return GENERATOR in document
    if not isinstance(stated, dict):
        return True
    try:
        return bool(stated.get("sha256") != content_digest(document))
    except ValueError:
        return True
