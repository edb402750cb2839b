"""What the benchmark calls overhead. Evidence: properties of its meter."""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path

import cv2
import pytest

import calib.stages.store

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))

import bench_calls
from bench_calls import KINDS, RunTimes


def burn(seconds: float) -> None:
    end = time.thread_time() + seconds
    while time.thread_time() < end:
        pass


def test_nested_calls_count_once_and_threads_add_up() -> None:
    meter = bench_calls._Meter()
    inner = meter.timed("detectors", burn)

    def solve() -> None:
        burn(0.05)
        inner(0.05)

    outer = meter.timed("solvers", solve)
    outer()
    assert meter.inside["detectors"] == 0
    assert meter.inside["solvers"] == pytest.approx(0.1, abs=0.03)
    threads = [threading.Thread(target=inner, args=(0.05,)) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert meter.inside["detectors"] == pytest.approx(0.15, abs=0.05)


def test_calls_are_found_under_the_names_modules_gave_them() -> None:
    """`from ... import least_squares` is another name; afterwards all is as it was."""
    from calib.fit import reweighting

    plain, finder = reweighting.least_squares, cv2.findChessboardCorners
    meter = bench_calls._Meter()
    with bench_calls._metered(meter):
        assert reweighting.least_squares is not plain
        assert cv2.findChessboardCorners is not finder
        reweighting.least_squares(lambda x: x - 1, [0.0])
    assert reweighting.least_squares is plain
    assert cv2.findChessboardCorners is finder
    assert meter.inside["solvers"] > 0


def test_calls_are_added_up() -> None:
    times = RunTimes(12.0, bench_calls.Counter(dict.fromkeys(KINDS, 2.0)), 8.0)
    assert times.calls("detectors", "solvers") == pytest.approx(4.0)
    assert times.calls(*KINDS) == pytest.approx(2.0 * len(KINDS))


def test_calls_are_of_one_process() -> None:
    """What workers spend would be found in no call."""
    with bench_calls._metered(bench_calls._Meter()):
        assert calib.stages.store.processors() == 1
