"""`calib gaze --follow` with a camera that no longer answers. Evidence: property."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from calib.cli import gaze
from calib.gaze import following, placing
from calib.rig.protocols import Lost, Refused


def followed(monkeypatch, errors, refused):
    """Follow through these errors; names of rows without a position go to `refused`."""
    left = iter(errors)

    def row(_):
        raise next(left)

    monkeypatch.setattr(following, "Follower", lambda *_: SimpleNamespace(row=row))
    monkeypatch.setattr(placing, "placing_for", lambda *_: SimpleNamespace(place=lambda _: None))
    monkeypatch.setattr(placing, "set_swaying", lambda _: None)
    table = SimpleNamespace(
        add=lambda *_: None, refuse=lambda name, _: refused.append(name), last_mm=1.0
    )
    eye = SimpleNamespace(gaze=lambda _: None)
    gaze._follow(SimpleNamespace(count=1 + len(errors)), None, eye, None, table)


def test_a_device_that_stays_lost_ends_it(monkeypatch):
    refused = []
    with pytest.raises(Lost, match="gone"):
        followed(monkeypatch, [Lost("gone")] * 9, refused)
    assert refused == ["t02", "t03", "t04"]


def test_targets_lost_from_sight_do_not(monkeypatch):
    errors = [Lost("once"), Lost("twice"), Refused("hidden"), Lost("once"), Refused("hidden")]
    refused = []
    followed(monkeypatch, errors, refused)
    assert len(refused) == 5
