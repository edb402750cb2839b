"""The virtual rig, device by device: each fault alone, and what the drivers make of it.

Evidence: simulated truth, which the world keeps and the drivers never see.
"""

import json
import math

import numpy as np
import pytest
from virtual_rigs import OPEN_LOOP, gaze_reading, shown, virtual_rig

from calib.core.errors import InputError, UsageError
from calib.gaze.target import target
from calib.geometry.board import Board
from calib.geometry.camera import project
from calib.images.detection.find import find_chessboard
from calib.rig.protocols import Camera, Interrupted, Lost, Refused, Stalled, YawAxis
from calib.rig.virtual.operator import Operator
from calib.simulate.rig import c2_pose
from calib.simulate.scene import fitting_board, invert

STEP = math.radians(0.05625)
COUNT = math.radians(0.009)


def true_reading(rig):
    return rig.world.yaw(rig.clock.now_ns())


def test_the_devices_are_what_the_protocols_ask_for():
    with virtual_rig() as rig:
        assert isinstance(rig.c1, Camera)
        assert isinstance(rig.c2, Camera)
        assert isinstance(rig.axis, YawAxis)
        assert rig.c1.image_size == (640, 480)
        assert len({rig.c1.identity, rig.c2.identity, rig.axis.identity}) == 3


def test_what_c2_sees_after_a_move_is_where_the_true_rig_projects_it():
    with virtual_rig() as rig:
        reading = shown(rig)
        standing = rig.axis.move(reading)
        frame = rig.c2.after(standing.since_ns, timeout_s=2)
        board, truth = rig.world.board, rig.world.rig
        found = find_chessboard(frame.pixels, board).pixels[board.target_index]
        in_c2 = invert(c2_pose(truth, np.array(true_reading(rig)))) @ np.append(
            rig.world.target(rig.clock.now_ns()), 1
        )
    assert found == pytest.approx(project(truth.c2, in_c2[None, :3])[0], abs=0.3)
    assert abs(in_c2[0] / in_c2[2]) < 1.1 * STEP
    assert frame.exposed_ns > standing.since_ns


def test_readings_are_whole_counts_of_where_c2_truly_stands():
    with virtual_rig() as rig:
        for reading in np.deg2rad([70.0, 111.3, 90.01]):
            standing = rig.axis.move(float(reading))
            assert abs(standing.reading_rad - reading) <= STEP
            assert abs(standing.reading_rad - true_reading(rig)) <= COUNT / 2 + 1e-12
            assert standing.source == "load encoder"


@pytest.mark.parametrize("reads", ["load encoder", "motor encoder"])
def test_an_encoder_finds_lost_steps_and_the_axis_goes_on(reads):
    with virtual_rig(axis={"reads": reads}, lost_steps_share=0.3) as rig:
        gone = 0
        for k in range(30):
            try:
                standing = rig.axis.move(math.radians(60 + 2 * k))
            except Stalled:
                continue
            gone += 1
            assert abs(standing.reading_rad - math.radians(60 + 2 * k)) < 1.5 * STEP
            assert abs(standing.reading_rad - true_reading(rig)) <= COUNT / 2 + 1e-12
    assert gone >= 25


def test_an_axis_that_counts_its_own_steps_cannot_know_of_lost_ones():
    with virtual_rig(axis=OPEN_LOOP, lost_steps_share=1.0) as rig:
        standing = rig.axis.move(math.radians(100))
        assert abs(standing.reading_rad - true_reading(rig)) > 60 * STEP
        rig.axis.home()
        assert abs(rig.axis.standstill().reading_rad - true_reading(rig)) < 1.5 * STEP


def test_a_move_that_another_hand_stops_is_no_success():
    with virtual_rig(stopped_share=1.0) as rig:
        with pytest.raises(Interrupted, match="another hand"):
            rig.axis.move(math.radians(100))
        # It stands where it was stopped, and says so truly.
        assert abs(rig.axis.standstill().reading_rad - true_reading(rig)) <= COUNT / 2 + 1e-12


def test_done_too_early_is_not_believed():
    with virtual_rig(early_done_ms=60.0) as rig:
        standing = rig.axis.move(math.radians(120))
        assert rig.world.yaw(standing.since_ns) == true_reading(rig)
        assert abs(standing.reading_rad - true_reading(rig)) <= COUNT / 2 + 1e-12


def test_backlash_moves_c2_only_where_the_side_of_approach_changes():
    with virtual_rig(axis=OPEN_LOOP, backlash_steps=5.0) as rig:
        middle = math.radians(90)
        rig.axis.move(middle, approach=1)
        up = true_reading(rig)
        rig.axis.move(middle + 40 * STEP, approach=1)
        rig.axis.move(middle, approach=1)
        again = true_reading(rig)
        standing = rig.axis.move(middle, approach=-1)
        down = true_reading(rig)
    assert again == pytest.approx(up, abs=1e-12)
    assert down - up == pytest.approx(5 * STEP, abs=1e-9)
    assert standing.approached == -1


@pytest.mark.parametrize("backlash", [0.0, 3.0, 10.0])
def test_an_encoder_on_the_load_reads_through_any_play(backlash):
    with virtual_rig(backlash_steps=backlash) as rig:
        for degrees in (80.0, 79.9, 80.05, 79.95, 101.0, 80.0):
            standing = rig.axis.move(math.radians(degrees))
            assert abs(standing.reading_rad - math.radians(degrees)) <= 1.5 * STEP
            assert standing.approached == 1
            assert abs(standing.reading_rad - true_reading(rig)) <= COUNT / 2 + 1e-12


@pytest.mark.parametrize("seed", range(3))
def test_with_all_faults_at_once_no_reading_is_of_another_place(seed):
    rng = np.random.default_rng(seed)
    faults = {
        "backlash_steps": float(rng.uniform(0, 10)),
        "lost_steps_share": 0.05,
        "stopped_share": 0.05,
        "truncated": True,
        "microstep_error": 0.05,
        "early_done_ms": float(rng.uniform(0, 50)),
        "ringing_ms": float(rng.uniform(0, 10)),
    }
    arrived = 0
    with virtual_rig(seed=seed, **faults) as rig:
        for wanted in rng.uniform(0.8, 2.3, 100):
            try:
                standing = rig.axis.move(float(wanted))
            except (Interrupted, Stalled):
                continue
            arrived += 1
            assert abs(standing.reading_rad - rig.world.yaw(standing.since_ns)) <= 1.5 * COUNT
            assert abs(standing.reading_rad - wanted) <= 1.5 * STEP
    assert arrived >= 70


def test_microsteps_err_once_a_full_step_and_counts_do_not_see_it():
    off = []
    with virtual_rig(axis=OPEN_LOOP, microstep_error=0.05) as rig:
        for k in range(33):
            standing = rig.axis.move(math.radians(90) + k * STEP)
            off.append(standing.reading_rad - true_reading(rig))
    off = np.array(off)
    assert np.abs(off).max() == pytest.approx(0.05 * 16 * STEP, rel=0.05)
    assert off[:16] == pytest.approx(off[16:32], abs=1e-9)


def test_a_controller_that_truncates_is_read_back():
    with virtual_rig(axis=OPEN_LOOP, truncated=True) as rig:
        off = []
        for k in range(1, 20):
            standing = rig.axis.move(math.radians(90) + k * STEP)
            off.append(standing.reading_rad - (math.radians(90) + k * STEP))
            assert standing.reading_rad == pytest.approx(true_reading(rig), abs=1e-12)
    assert np.min(off) == pytest.approx(-STEP / 16, rel=1e-6)


def test_a_reversed_encoder_turns_c2_the_other_way():
    with virtual_rig(reversed=True) as rig:
        standing = rig.axis.move(math.radians(100))
        assert true_reading(rig) == pytest.approx(math.pi - standing.reading_rad, abs=COUNT)


def test_ringing_is_waited_for_by_whoever_reads_the_load():
    with virtual_rig(ringing_ms=80.0) as rig:
        standing = rig.axis.move(math.radians(100))
        assert abs(rig.world.yaw(standing.since_ns) - true_reading(rig)) < 3 * COUNT


def test_each_reference_run_has_a_name_and_a_zero_of_its_own():
    with virtual_rig(axis=OPEN_LOOP) as rig:
        first = rig.axis.standstill()
        second = rig.axis.home()
        third = rig.axis.home()
        assert len({first.home, second.home, third.home}) == 3
        assert second.reading_rad - true_reading(rig) != first.reading_rad - math.pi / 2


def test_what_is_out_of_reach_is_refused_without_moving():
    with virtual_rig() as rig:
        with pytest.raises(Refused, match=r"200\.000 deg, outside its range of 40 to 140 deg"):
            rig.axis.move(math.radians(200))
        assert true_reading(rig) == math.pi / 2


def test_frames_are_exposed_after_the_moment_whatever_the_line_does():
    faults = {
        "latency_frames": 4,
        "clock_offset_s": 3600.0,
        "clock_drift_ppm": 100.0,
        "dropped_share": 0.2,
        "torn_share": 0.2,
    }
    with virtual_rig(**faults) as rig:
        Operator(rig.world).show_gaze()
        for k in range(12):
            standing = rig.axis.move(math.radians(80 + k))
            frame = rig.c2.after(standing.since_ns, timeout_s=2)
            begin = 40_000_000 * frame.serial + rig.c2._sensor._first
            assert standing.since_ns < frame.exposed_ns <= begin
            assert begin - frame.exposed_ns < 1_000_000


def test_a_clock_that_lies_in_the_future_by_an_hour_changes_no_frame():
    with virtual_rig() as rig, virtual_rig(clock_offset_s=3600.0) as late:
        for each in (rig, late):
            Operator(each.world).show_gaze()
        one, other = (each.c1.after(each.clock.now_ns(), timeout_s=1) for each in (rig, late))
    assert one.serial == other.serial
    assert np.array_equal(one.pixels, other.pixels)


def test_a_driver_that_lies_hands_out_an_old_frame():
    with virtual_rig(stale=True, latency_frames=4) as rig:
        shown(rig)
        standing = rig.axis.move(math.radians(85))
        frame = rig.c2.after(standing.since_ns, timeout_s=2)
        begin = 40_000_000 * frame.serial + rig.c2._sensor._first
        assert begin < standing.since_ns < frame.exposed_ns


def test_torn_frames_come_and_are_told_by_the_numbers_of_their_lines():
    with virtual_rig(torn_share=1.0) as rig:
        Operator(rig.world).show_gaze()
        packet = rig.c1._sensor.next(10**9, 2 * 10**9)
        assert packet.first != packet.last
        with pytest.raises(Lost, match="no whole frame"):
            rig.c1.after(rig.clock.now_ns(), timeout_s=0.5)
        assert rig.c1.latest() is None


def test_a_camera_whose_frames_never_arrive_is_lost_in_time():
    with virtual_rig(dropped_share=1.0, torn_share=0.0) as rig:
        begin = rig.clock.now_ns()
        with pytest.raises(Lost, match="virtual camera c1"):
            rig.c1.after(begin, timeout_s=0.5)
        assert rig.clock.now_ns() - begin < 10**9


def test_an_exposure_integrates_the_motion():
    with virtual_rig(exposure_ms=20.0) as rig:
        shown(rig)
        rest = rig.c2.after(rig.clock.now_ns(), timeout_s=1).pixels
        controller = rig.axis._controller
        controller.start(600)
        rig.clock.wait_until(rig.clock.now_ns() + 60_000_000)
        moved = rig.c2.after(rig.clock.now_ns(), timeout_s=1).pixels
    sharp, smeared = (np.abs(np.diff(p.astype(float), axis=1)).max() for p in (rest, moved))
    assert smeared < 0.6 * sharp
    assert find_chessboard(rest, rig.world.board) is not None


def test_a_target_may_be_moved_in_mid_gaze():
    with virtual_rig(moving_share=1.0) as rig:
        Operator(rig.world).show_gaze()
        first = rig.world.target(rig.clock.now_ns())
        later = rig.world.target(rig.clock.now_ns() + 1_100_000_000)
    assert 3 <= np.linalg.norm(later - first) <= 40


def test_targets_cover_the_working_depths():
    with virtual_rig() as rig:
        operator, near_far = Operator(rig.world), rig.world.rig.depth_range_mm
        depths = []
        for _ in range(16):
            operator.show_gaze()
            depths.append(rig.world.target(rig.clock.now_ns())[2])
            assert math.radians(40) < gaze_reading(rig) < math.radians(140)
    counted, _ = np.histogram(depths, bins=4, range=near_far)
    assert counted.min() >= 3


def test_a_left_rig_and_any_board_can_be_simulated():
    board = {
        "type": "charuco",
        "columns": 6,
        "rows": 4,
        "square_mm": 60.0,
        "target": [3, 2],
        "dictionary": "DICT_4X4_50",
        "marker_mm": 45.0,
    }
    with virtual_rig(board=board, baseline_mm=-200.0) as rig:
        assert rig.world.rig.is_left
        assert rig.world.rig.theta[0] == -200.0
        assert shown(rig) > math.pi / 2 - 0.1
        assert isinstance(rig.world.board, Board)
        assert rig.world.board != fitting_board(rig.world.rig, near_mm=1000)


def test_the_truth_is_written_only_on_demand(tmp_path):
    path = tmp_path / "truth.jsonl"
    with virtual_rig(truth=str(path)) as rig:
        shown(rig)
        point = rig.world.target(rig.clock.now_ns())
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert [line["event"] for line in lines] == ["rig", "target"]
    assert lines[0]["parameters"]["baseline_mm"] == 200.0
    assert lines[1]["xyz_mm"] == pytest.approx(point.tolist())


def test_equal_seeds_give_equal_frames():
    def frame():
        with virtual_rig(seed=4, latency_frames=2) as rig:
            standing = rig.axis.move(shown(rig))
            return rig.c2.after(standing.since_ns, timeout_s=1)

    one, other = frame(), frame()
    assert one.serial == other.serial
    assert np.array_equal(one.pixels, other.pixels)


@pytest.mark.parametrize("kind", ["board", "tag:DICT_APRILTAG_36h11:7", "cross", "blob"])
def test_each_target_is_seen_where_it_stands(kind):
    with virtual_rig(target=kind) as rig:
        operator = Operator(rig.world)
        for _ in range(3):
            operator.show_gaze()
            frame = rig.c1.after(rig.clock.now_ns(), timeout_s=1)
            found = target(kind, rig.world.board).find(frame.pixels)
            point = rig.world.target(rig.clock.now_ns())
            assert found.pixel == pytest.approx(project(rig.world.rig.c1, point[None])[0], abs=0.3)


def test_an_unknown_target_is_refused():
    with pytest.raises(UsageError, match="names no tag"), virtual_rig(target="tag:DICT_X:7"):
        pass
    with pytest.raises(UsageError, match="write 'board'"), virtual_rig(target="moon"):
        pass


def test_a_key_that_virtual_devices_do_not_have_is_named():
    unknown = r"\[axis\] overshot_steps: is no key .*did you mean"
    with pytest.raises(InputError, match=unknown), virtual_rig(axis={"overshot_steps": 3}):
        pass
    unknown = r"\[cameras.c1\] exposure_us: is no key"
    with pytest.raises(InputError, match=unknown), virtual_rig(cameras={"exposure_us": 3}):
        pass
