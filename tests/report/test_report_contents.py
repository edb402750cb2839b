"""The report holds the results: its tables, words and pictures say what was found.

Evidence: the numbers of the results themselves, read back from the page.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from lxml import etree, html
from page_parts import decoded, keys, table
from report_examples import everything, images, paper

from calib.report import plotting
from calib.report.numbers import plus_minus
from calib.report.page import render_report
from calib.report.sections.board_pictures import LEFT_OUT, picture_sheets
from calib.report.sections.intrinsics import _pictures
from calib.results.effective_baseline import effective_baseline
from calib.results.headline import headline


def test_depth_table_holds_the_results(page: html.HtmlElement) -> None:
    depths = everything()[0].gaze.depths
    rows = table(page, "Depth uncertainty")
    np.testing.assert_array_equal(keys(rows, 0), depths.depth_mm)
    np.testing.assert_array_equal(keys(rows, 1), depths.prediction.u_mm)
    np.testing.assert_array_equal(keys(rows, 4), depths.prediction.gum_u_mm)
    assert [row[6].text_content() == "extrapolated" for row in rows] == list(
        map(bool, depths.extrapolated)
    )


def test_validation_table_holds_the_results(page: html.HtmlElement) -> None:
    v = everything()[0].gaze.validation
    rows = table(page, "Validation rows")
    assert [row[0].text_content() for row in rows] == list(v.ids)
    np.testing.assert_array_equal(keys(rows, 4), v.prediction.z_mm)
    np.testing.assert_array_equal(keys(rows, 7), 100 * v.errors[0].error_rel)
    apart = [row[7].get("class").endswith("bad") for row in rows]
    # The ruler and the stereo reference disagree about the nearest and the farthest board.
    assert apart == [name.startswith(("1-", "4-")) for name in v.ids]


def test_group_spread_shows_the_axis_offset(page: html.HtmlElement) -> None:
    rows = table(page, "Spread within groups")
    assert keys(rows[:1], 3)[0] > 8
    assert keys(rows[:1], 4)[0] < 2.5


def test_parameter_tables_hold_the_posterior(page: html.HtmlElement) -> None:
    gaze = everything()[0].gaze
    for model, posterior in gaze.posterior.items():
        rows = table(page, f"Model {model}")
        free = len(posterior.names) - 1
        factors = [1e3 if name.endswith("_rad") else 1.0 for name in posterior.names]
        shown = keys(rows[:free], 2)
        np.testing.assert_allclose(shown, (posterior.mean * factors)[:free], rtol=1e-15)
        assert keys(rows[-1:], 2) == [posterior.mean[-1]]
        covariance = posterior.covariance[:free, :free]
        derived = effective_baseline(posterior.names[:free], posterior.mean[:free], covariance)
        assert (derived is None) == (model == "base")
        if derived is not None:
            assert keys(rows[free : free + 1], 2) == [derived[0]]


def test_the_place_of_the_yaw_axis_has_one_value(page: html.HtmlElement) -> None:
    found = headline(everything()[0].gaze)
    assert found is not None
    i = found.names.index("axis_z_mm")
    stated = plus_minus(found.values[i], found.covariance[i, i] ** 0.5)
    verdict, residuals, linear = (
        page.xpath(f"//section[@id='{name}']")[0].text_content()
        for name in ("verdict", "residuals", "linear")
    )
    assert f"{stated} mm" in verdict
    assert f"C1's optical centre (Za = {stated} mm)" in residuals
    assert f"By axis-offset it is {stated} mm." in linear


def test_what_the_rows_can_tell_is_said_in_words_and_figures(page: html.HtmlElement) -> None:
    gaze = everything()[0].gaze
    found = gaze.identifiability["axis-offset"]
    section = page.xpath("//section[@id='identifiability']")[0]
    (notice,) = section.xpath("./details/div[contains(@class, 'notice')]")
    assert "cannot distinguish Lb from e" in notice.text_content()
    assert all(remedy in notice.text_content() for remedy in found.open[0].remedies)
    rows = table(page, "axis-offset: its combinations")
    assert keys(rows, 1) == [c.singular_value for c in found.combinations]
    assert rows[-1][-1].get("class") == "bad"
    rows = table(page, "axis-offset: how far each parameter is known")
    factors = [1, 1e3, 1, 1]
    np.testing.assert_allclose(keys(rows, 3), found.rows_std * factors, rtol=1e-15)
    rows = table(page, "Model by model")
    assert keys(rows, 5) == [
        100 * gaze.identifiability[model].depth_std_rel for model in ("axis-offset", "base")
    ]


def test_values_are_rounded_to_their_uncertainty(page: html.HtmlElement) -> None:
    cells = page.xpath("//td[@data-key and contains(., ' ± ')]")
    assert len(cells) > 100
    for cell in cells:
        value, u = cell.text_content().split(" ± ")
        assert len(value.partition(".")[2]) == len(u.partition(".")[2]), cell.text_content()


def test_comparison_holds_the_results(page: html.HtmlElement) -> None:
    scores = everything()[0].gaze.comparison.scores
    rows = table(page, "Models side by side")
    assert keys(rows, 2) == [score.loo for score in scores]
    assert keys(rows, 3) == [score.weight for score in scores]
    assert keys(rows, 4) == [score.averaging_weight for score in scores]
    assert keys(rows, 6) == [score.bic for score in scores]
    chosen = [row[0].text_content() for row in rows if row[0].get("class") == "good"]
    assert chosen == [everything()[0].gaze.comparison.selected]


def test_the_comparison_names_the_rows_it_refitted() -> None:
    calibration, context = paper()
    found = calibration.gaze.comparison
    names = tuple(f"row{i}" for i in range(12))
    scores = (replace(found.scores[0], refitted=names), *found.scores[1:])
    gaze = replace(calibration.gaze, comparison=replace(found, scores=scores))
    page = html.document_fromstring(render_report(replace(calibration, gaze=gaze), context))
    assert keys(table(page, "Models side by side"), 10)[0] == 12
    told = page.xpath("string(//section[@id='comparison'])")
    assert f"{scores[0].model}: {', '.join(names[:10])} …" in told


def test_intrinsics_and_stereo_hold_the_results(page: html.HtmlElement) -> None:
    found = images()
    rows = table(page, "Fits of C1")
    fits = (found.intrinsics["c1"].selected, *found.intrinsics["c1"].alternatives)
    assert [float(c.get("data-key")) for c in rows[0][1:]] == [f.camera.matrix[0, 0] for f in fits]
    rows = table(page, "Pose of C2 in C1")
    assert [float(c.get("data-key")) for c in rows[3][1:]] == [
        solve.pose_12[3] for solve in found.stereo.solves
    ]
    rows = table(page, "What the sweep measures")
    assert keys(rows, 2) == [14.9, 1.0, 0.001]


def test_the_finding_is_told_in_figures(page: html.HtmlElement) -> None:
    told = page.xpath("string(//section[@id='residuals'])")
    fits = everything()[0].gaze.robust
    for model in ("base", "axis-offset"):
        assert f"{fits[model].sigma_mrad:.2g} mrad" in told


def test_a_depth_without_upper_limit_is_printed_as_such() -> None:
    calibration, context = paper()
    depths = calibration.gaze.depths
    u, high = depths.prediction.u_mm.copy(), depths.prediction.high95_mm.copy()
    u[-3:] = high[-3:] = np.inf
    prediction = replace(depths.prediction, u_mm=u, high95_mm=high)
    gaze = replace(calibration.gaze, depths=replace(depths, prediction=prediction))
    page = html.document_fromstring(render_report(replace(calibration, gaze=gaze), context))
    last = table(page, "Depth uncertainty")[-1]
    assert last[1].text_content() == "∞"
    assert last[3].text_content().endswith(" to ∞")


def test_every_picture_is_listed_by_name_and_those_left_out_are_framed() -> None:
    calibration, context = everything()
    found = calibration.images.intrinsics["c1"]
    residuals = found.selected.residuals.copy()
    residuals[0] = np.nan
    spoilt = replace(found, selected=replace(found.selected, residuals=residuals))
    images = replace(calibration.images, intrinsics={**calibration.images.intrinsics, "c1": spoilt})
    page = html.fromstring(render_report(replace(calibration, images=images), context))
    (table,) = page.xpath("//table[caption='Pictures of C1']")
    rows = [[cell.text_content().strip() for cell in row] for row in table.xpath(".//tbody/tr")]
    assert [row[0] for row in rows] == list(found.images)
    assert "left out" in rows[0][-1]
    assert all("left out" not in row[-1] for row in rows[1:])
    framed = page.xpath("//figure[@id='figure-pictures-c1']//li[@class='bad']/bdi/text()")
    sheet = calibration.images.sheets["c1"]
    assert (found.images[0] in framed) == (found.images[0] in sheet.names)


def test_a_picture_rejected_before_the_refinement_is_framed_and_listed_too() -> None:
    found, sheets = images().intrinsics["c1"], images().sheets["c1"]
    gone = next(name for name in found.images if name in sheets.names)
    kept = [i for i, name in enumerate(found.images) if name != gone]
    refined = replace(
        found,
        images=tuple(found.images[i] for i in kept),
        selected=replace(found.selected, residuals=found.selected.residuals[kept]),
        rejected_views=(gone,),
    )
    changed = replace(images(), intrinsics={**images().intrinsics, "c1": refined})
    (sheet,) = (s for s in picture_sheets(changed) if s.key == "pictures-c1")
    faults = {picture.name: picture.fault for picture in sheet.pictures}
    assert faults[gone] == LEFT_OUT
    corners = changed.corners["c1"].select(refined.images).pixels
    listed = _pictures(refined, corners)
    assert listed.rows[-1][0].text == gone
    assert listed.rows[-1][-1].text == LEFT_OUT
    assert len(listed.rows) == len(found.images)


def test_pictures_show_corners_and_residuals_where_they_are() -> None:
    calibration, context = everything()
    found = calibration.images.intrinsics["c1"]
    residuals = found.selected.residuals.copy()
    residuals[0, 2] = np.nan
    spoilt = replace(found, selected=replace(found.selected, residuals=residuals))
    images = replace(calibration.images, intrinsics={**calibration.images.intrinsics, "c1": spoilt})
    page = html.fromstring(render_report(replace(calibration, images=images), context))
    items = page.xpath("//figure[@id='figure-pictures-c1']//li")
    assert len(items) == len(calibration.images.corners["c1"].images)
    caption = page.xpath("string(//figure[@id='figure-pictures-c1']/figcaption)")
    times = float(re.search(r"Arrows are residuals, (\S+) times", caption)[1])
    (item,) = [li for li in items if li.findtext("bdi") == found.images[0]]
    drawn = etree.fromstring(decoded(item.find("img").get("src")))
    paths: dict[str, list[str]] = {}
    for path in drawn.iter("{*}path"):
        paths.setdefault(path.get("stroke"), []).append(path.get("d"))
    corners = calibration.images.corners["c1"].select(found.images[:1]).pixels[0]
    arrows = re.findall(r"M([-\d.]+) ([-\d.]+)l([-\d.]+) ([-\d.]+)l", paths[plotting.ORANGE][0])
    kept = np.isfinite(residuals[0]).all(axis=-1)
    expected = np.hstack([corners, times * residuals[0]])[kept]
    np.testing.assert_allclose(np.array(arrows, float), expected, atol=0.051)
    assert "rms " in item.text_content()
    rejected = paths[plotting.VERMILLION][0]
    width = calibration.images.corners["c1"].image_size[0]
    at = corners[2] - width / 160
    assert rejected.startswith(f"M{at[0]:.1f} {at[1]:.1f}l")


def test_pairs_and_sweep_are_listed_by_the_names_of_their_pictures() -> None:
    calibration, context = everything()
    stereo = calibration.images.stereo
    pairs = {stem: (f"s/c1/{stem}.png", f"s/c2/{stem}.png") for stem in (*stereo.stems, "alone")}
    images = replace(calibration.images, pairs=pairs)
    page = html.fromstring(render_report(replace(calibration, images=images), context))
    rows = table(page, "Pairs")
    assert [row[0].text_content().strip() for row in rows] == [p[0] for p in pairs.values()]
    assert "not used" in rows[-1][-1].text_content()
    first = stereo.solves[0].residuals[1, 0]
    assert float(rows[0][6].get("data-key")) == pytest.approx(np.sqrt(np.nanmean(first**2)))
    sweep = calibration.images.sweep
    rows = table(page, "Pictures of the sweep")
    assert [row[0].text_content().strip() for row in rows] == list(sweep.images)
    assert keys(rows, 3) == pytest.approx(np.sqrt(np.nanmean(sweep.residuals**2, axis=(1, 2))))
