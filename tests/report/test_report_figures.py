"""What the figures draw, read back from their artists.

Evidence: properties; the normal density, whose regions are known.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver
from matplotlib.text import Text
from report_examples import everything, paper

from calib.report import plotting
from calib.report.figures import maps
from calib.report.figures.posterior import draw_corner
from calib.report.figures.setup import draw_setup
from calib.report.page import render_report
from calib.report.plotting import csv_text


@pytest.fixture(scope="module")
def corner() -> tuple[np.ndarray, Figure]:
    """Draws from a correlated normal density, and the figure of them."""
    posterior = paper()[0].gaze.posterior["base"]
    rng = np.random.default_rng(0)
    count = len(posterior.names)
    covariance = 0.6 * np.ones((count, count)) + 0.4 * np.eye(count)
    flat = rng.multivariate_normal(np.zeros(count), covariance, 16_000)
    draws = flat.reshape(1, -1, count)
    made = replace(posterior, draws=draws, quantiles=np.quantile(flat, [0.025, 0.5, 0.975], 0).T)
    return made.flat, draw_corner(made).figure


def test_the_regions_of_a_corner_plot_hold_the_stated_mass(corner) -> None:
    """Smoothing by 0.22 standard deviations widens a region of one by 2.5 % of its radius.

    At one standard deviation that is 0.015 of the mass, at two 0.014; counting adds 0.004.
    """
    flat, figure = corner
    panel = next(axes for axes in figure.axes if axes.findobj(QuadContourSet))
    lines = next(found for found in panel.findobj(QuadContourSet) if not found.filled)
    scale = np.array([1.0, 1e3])  # mm, and mrad from rad: the first two of base
    inside = [path.contains_points(flat[:, :2] * scale).mean() for path in lines.get_paths()]
    assert inside == pytest.approx([0.865, 0.393], abs=0.03)


def test_a_corner_plot_has_a_panel_for_each_pair_and_each_parameter_alone(corner) -> None:
    flat, figure = corner
    count = flat.shape[1]
    assert (
        sum(bool(axes.findobj(QuadContourSet)) for axes in figure.axes) == count * (count - 1) / 2
    )
    assert len([axes for axes in figure.axes if axes.get_xlabel()]) == count
    assert len([axes for axes in figure.axes if axes.get_ylabel()]) == count - 1


def test_a_posterior_of_one_draw_is_drawn() -> None:
    """A chain that never moved: no width, no levels, but a figure beside the failed gate."""
    posterior = paper()[0].gaze.posterior["base"]
    stuck = replace(posterior, draws=np.repeat(posterior.draws[:1, :1], 500, axis=1))
    assert draw_corner(stuck).figure.axes


def test_arrows_of_a_field_point_along_it_and_none_crosses_others() -> None:
    rng = np.random.default_rng(1)
    v, u = np.meshgrid(np.arange(0.0, 600, 50), np.arange(0.0, 800, 50), indexing="ij")
    pixels, field = np.stack([u, v], axis=-1), rng.normal(size=(*u.shape, 2))
    field[3, 3] *= 1e3
    covered = np.ones(u.shape, bool)
    covered[0] = False
    axes = maps.map_figure((800, 600)).subplots()
    maps.draw_field(axes, pixels, field, covered)
    (arrows,) = axes.findobj(Quiver)
    assert np.column_stack([arrows.X, arrows.Y]) == pytest.approx(pixels[covered])
    drawn = np.column_stack([arrows.U, arrows.V]) / arrows.scale
    asked = field[covered]
    turned = drawn[:, 0] * asked[:, 1] - drawn[:, 1] * asked[:, 0]
    assert turned == pytest.approx(np.zeros(len(turned)), abs=1e-9 * 1e5)
    length, wanted = np.linalg.norm(drawn, axis=1), np.linalg.norm(asked, axis=1)
    assert length.max() == pytest.approx(maps.LONGEST * 50)
    free = length < 0.999 * maps.LONGEST * 50
    ratio = length[free] / wanted[free]
    assert ratio == pytest.approx(np.full(free.sum(), ratio[0]))
    assert np.quantile(wanted * ratio[0], 0.95) == pytest.approx(50), "a cell's width"


def cut_off(figure: Figure) -> list[str]:
    """Return the titles, labels and legends of a figure that reach beyond its edge."""
    figure.draw_without_rendering()
    renderer = figure.canvas.get_renderer()
    own = [figure.legends, [t for axes in figure.axes for t in _words_of(axes)]]
    found = []
    for text in (t for group in own for artist in group for t in artist.findobj(Text)):
        box = text.get_window_extent(renderer)
        if text.get_text().strip() and not (
            -1 <= box.x0 <= box.x1 <= figure.bbox.width + 1
            and -1 <= box.y0 <= box.y1 <= figure.bbox.height + 1
        ):
            found.append(text.get_text())
    return found


def _words_of(axes: Axes) -> list[Artist]:
    legend = axes.get_legend()
    return [axes.title, axes.xaxis.label, axes.yaxis.label, *([] if legend is None else [legend])]


def test_no_word_of_a_figure_is_cut_off(monkeypatch: pytest.MonkeyPatch) -> None:
    calibration, context = everything()
    drawn: list[Figure] = []
    svg = plotting.svg

    def recorded(figure: Figure) -> bytes:
        drawn.append(figure)
        return svg(figure)

    monkeypatch.setattr(plotting, "svg", recorded)
    first = calibration.images.stereo.solves[0]
    backends = ("joint", "mrcal", "opencv", "joint")
    four = tuple(replace(first, backend=name, intrinsics="held") for name in backends)
    stereo = replace(calibration.images.stereo, solves=four)
    images = replace(calibration.images, stereo=stereo)
    render_report(replace(calibration, images=images), context)
    rows, theta = calibration.gaze.rows, calibration.gaze.robust["axis-offset"].theta
    long = "$L_{b}$ + $e$ = 130.97361 ± 0.00048 mm\n95 %: 130.96411 to 130.98310 mm"
    drawn.append(draw_setup(rows, theta, ("baseline_mm", "axis_z_mm"), effective=long).figure)
    assert len(drawn) > 15
    assert [words for figure in drawn for words in cut_off(figure)] == []


def test_data_files_hold_seven_digits_and_nothing_for_what_does_not_exist() -> None:
    text = csv_text(
        {
            "id": ("a", "b", "c"),
            "mixed": [1.5, None, float("nan")],
            "float": np.array([1 / 3, np.nan, -2e-9]),
            "count": np.array([1, 2, 3]),
        }
    )
    assert text.splitlines() == [
        "id,mixed,float,count",
        "a,1.5,0.3333333,1",
        "b,,,2",
        "c,,-2e-09,3",
    ]
