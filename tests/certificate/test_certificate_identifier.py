"""Identifiers and times of issue. Evidence: property."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone

import pytest

from calib.certificate.inputs import new_issue

DIGITS = "0123456789ab"


def test_identifiers_never_repeat() -> None:
    now = datetime(2026, 2, 1, 9, 30, 12, tzinfo=UTC)
    first = new_issue(now=now, dataset_sha256="3f2a9c1b" + "0" * 56, token=DIGITS)
    assert first.identifier == "AG-20260201T093012Z-3F2A9C1B-0123456789AB"
    assert first.issued == "2026-02-01"
    other_token = new_issue(now=now, dataset_sha256="3f2a9c1b", token="a" * 12)
    other_data = new_issue(now=now, dataset_sha256="00000000", token=DIGITS)
    later = new_issue(now=now + timedelta(seconds=1), dataset_sha256="3f2a9c1b", token=DIGITS)
    everything = {first.identifier, other_token.identifier, other_data.identifier, later.identifier}
    assert len(everything) == 4


def test_the_date_of_issue_is_that_of_the_identifier() -> None:
    zone = timezone(timedelta(hours=9))
    issue = new_issue(
        now=datetime(2026, 2, 1, 3, 0, tzinfo=zone), dataset_sha256="3f2a9c1b", token=DIGITS
    )
    assert issue.issued == "2026-01-31"
    assert "20260131T180000Z" in issue.identifier


@pytest.mark.parametrize("token", ["", "0123", "0123456789AG", "<script>abcd"])
def test_a_weak_token_is_refused(token: str) -> None:
    with pytest.raises(ValueError, match="hexadecimal"):
        new_issue(now=datetime.now(UTC), dataset_sha256="3f2a9c1b", token=token)


def test_a_time_without_zone_is_refused() -> None:
    with pytest.raises(ValueError, match="time zone"):
        new_issue(now=datetime(2026, 1, 1), dataset_sha256="3f2a9c1b", token=DIGITS)
