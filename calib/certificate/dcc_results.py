"""The measurement results of a Digital Calibration Certificate."""

from __future__ import annotations

from collections.abc import Sequence

from calib.certificate.data import (
    BudgetLine,
    CertificateData,
    CertificateField,
    DepthLine,
    Judgement,
    Matrix,
    Region,
    Result,
)
from calib.certificate.elements import UNITS, Content, dcc, rich_text, si, software
from calib.results.wording import METHOD_REFERENCE, NORMS, NOT_STATED

COVERAGE = "0.95"


def results(d: CertificateData) -> Content:
    """Return the methods, conditions and results."""
    measured = [_measurement("Parameters of the instrument", _parameters(d))]
    if d.depths:
        measured.append(_measurement("Depth", [_depth(line) for line in d.depths]))
    if d.checks:
        found = [_checked(error, judged) for error, judged in d.checks]
        measured.append(_measurement("Independent check of depth", found, d.check_summary))
    if d.lengths:
        found = [_result(e.name, e.meaning, _quantity(e), *_expanded(e)) for e in d.lengths]
        measured.append(_measurement("Error of length", found, d.length_summary))
    return dcc(
        "measurementResults",
        dcc("usedMethods", _method(d)),
        software("usedSoftware", d.software),
        dcc("influenceConditions", *_conditions(d)),
        *measured,
    )


def _method(d: CertificateData) -> Content:
    return dcc(
        "usedMethod",
        rich_text("name", "Calibration of active gazing"),
        rich_text("description", d.method),
        *(dcc("norm", text=norm) for norm in NORMS),
        dcc("reference", text=METHOD_REFERENCE),
    )


def _conditions(d: CertificateData) -> list[Content]:
    return [
        dcc("influenceCondition", rich_text("name", name), dcc("data", _condition(value, unit)))
        for name, value, unit in (
            ("temperature", d.temperature_c, "°C"),
            ("relative humidity", d.humidity_percent, "%"),
        )
    ]


def _condition(value: str | None, unit: str) -> Content:
    if value is None:
        return dcc("quantity", rich_text("noQuantity", NOT_STATED))
    return dcc("quantity", si("real", si("value", text=value), si("unit", text=UNITS[unit])))


def _measurement(name: str, results: Sequence[Content], words: str | None = None) -> Content:
    described = [] if words is None else [rich_text("description", words)]
    return dcc("measurementResult", rich_text("name", name), *described, dcc("results", *results))


def _result(name: str, words: str, *data: Content) -> Content:
    return dcc(
        "result", rich_text("name", name), rich_text("description", words), dcc("data", *data)
    )


def _parameters(d: CertificateData) -> list[Content]:
    found = [
        _result(p.name, f"{p.meaning}; {p.remark}", _quantity(p), *_expanded(p))
        for p in d.parameters
    ]
    return [*found, _matrix(d.covariance)]


def _matrix(m: Matrix) -> Content:
    """Return a covariance matrix as a list of its rows, each with its units."""
    rows = [
        dcc(
            "quantity",
            rich_text("name", name),
            si(
                "realListXMLList",
                si("valueXMLList", text=" ".join(row)),
                si("unitXMLList", text=" ".join(UNITS[m.units[i]] + UNITS[u] for u in m.units)),
            ),
        )
        for i, (name, row) in enumerate(zip(m.names, m.rows, strict=True))
    ]
    words = f"rows and columns: {', '.join(m.names)}"
    return _result("Covariance of the parameters", words, dcc("list", *rows))


def _quantity(r: Result, judged: Judgement | None = None) -> Content:
    metadata = [] if judged is None else [dcc("measurementMetaData", _judged(judged))]
    return dcc("quantity", rich_text("name", r.name), _real(r), *metadata)


def _real(r: Result) -> Content:
    return si(
        "real",
        si("value", text=r.value),
        si("unit", text=UNITS[r.unit]),
        *_uncertainty(r),
    )


def _uncertainty(r: Result) -> list[Content]:
    if not r.from_interval and r.expanded_uncertainty is not None:
        stated = si(
            "expandedMU",
            si("valueExpandedMU", text=r.expanded_uncertainty),
            si("coverageFactor", text=r.coverage_factor or "NaN"),
            si("coverageProbability", text=COVERAGE),
        )
    elif r.low is not None and r.high is not None:
        stated = si(
            "coverageIntervalMU",
            si("valueStandardMU", text=r.standard_uncertainty or "NaN"),
            si("intervalMin", text=r.low),
            si("intervalMax", text=r.high),
            si("coverageProbability", text=COVERAGE),
        )
    elif r.standard_uncertainty is not None:
        stated = si("standardMU", si("valueStandardMU", text=r.standard_uncertainty))
    else:
        return []
    return [si("measurementUncertaintyUnivariate", stated)]


def _judged(j: Judgement) -> Content:
    words = (
        f"tolerance ±{j.limit} mm, tolerance / U {j.ratio}, probability of conformance "
        f"{j.probability} %"
    )
    if j.warning is not None:
        words += f"; {j.warning}"
    return dcc("metaData", rich_text("declaration", words), dcc("conformity", text=j.verdict))


def _depth(line: DepthLine) -> Content:
    words = f"at x1c = {line.ray}; {line.depth.remark}"
    if line.extrapolated:
        words += "; extrapolated: outside the calibrated range"
    return _result(
        f"Depth {line.depth.value} mm",
        words,
        _quantity(line.depth, line.judgement),
        *_expanded(line.depth),
        _position(line.region),
        _contributions(line.contributions),
        _budget(line.budget),
    )


def _expanded(r: Result) -> list[Content]:
    """Return U and k of an interval, which D-SI's coverage interval has no place for."""
    if not r.from_interval or r.expanded_uncertainty is None or r.coverage_factor is None:
        return []
    return [
        dcc(
            "list",
            rich_text("name", "expanded uncertainty, from the 95 % interval of the distribution"),
            _number("U, half the interval", r.expanded_uncertainty, UNITS[r.unit]),
            _number("k = U / u", r.coverage_factor, UNITS["1"]),
        )
    ]


def _number(name: str, value: str, unit: str) -> Content:
    return dcc(
        "quantity",
        rich_text("name", name),
        si("real", si("value", text=value), si("unit", text=unit)),
    )


def _budget(lines: Sequence[BudgetLine]) -> Content:
    return dcc(
        "list",
        rich_text("name", "uncertainty budget of depth (JCGM 100)"),
        *(_budget_line(line) for line in lines),
    )


def _budget_line(line: BudgetLine) -> Content:
    unit, mm = UNITS[line.unit], UNITS["mm"]
    sensitivity, contribution = line.numbers
    per = mm if line.unit == "1" else f"{mm}{unit}\\tothe{{-1}}"
    standard = si("standardMU", si("valueStandardMU", text=line.standard_uncertainty))
    return dcc(
        "list",
        rich_text("name", line.quantity),
        rich_text("description", f"type {line.evaluation}; {line.distribution}"),
        dcc(
            "quantity",
            rich_text("name", "estimate"),
            si(
                "real",
                si("value", text=line.estimate),
                si("unit", text=unit),
                si("measurementUncertaintyUnivariate", standard),
            ),
        ),
        _number("sensitivity", sensitivity, per),
        _number("contribution", contribution, mm),
        _number("share of the variance", line.share, UNITS["%"]),
    )


def _contributions(sources: Sequence[CertificateField]) -> Content:
    return dcc(
        "list",
        rich_text("name", "contributions to the standard uncertainty of depth"),
        *(_number(source.label, source.value, UNITS["mm"]) for source in sources),
    )


def _position(region: Region) -> Content:
    unit = UNITS["mm"]
    three = f"{unit} {unit} {unit}"
    squared = f"{unit}\\tothe{{2}}"
    columns = [
        si(
            "columnXMLList",
            si(
                "covarianceXMLList",
                si("valueXMLList", text=" ".join(column)),
                si("unitXMLList", text=" ".join([squared] * 3)),
            ),
        )
        for column in region.covariance
    ]
    return dcc(
        "quantity",
        rich_text("name", "position x, y, z"),
        si(
            "realListXMLList",
            si("valueXMLList", text=" ".join(region.position)),
            si("unitXMLList", text=three),
            si(
                "measurementUncertaintyMultivariateXMLList",
                si(
                    "ellipsoidalRegionMUXMLList",
                    si("covarianceMatrixXMLList", *columns),
                    si("coverageFactorXMLList", text=region.coverage_factor),
                    si("coverageProbabilityXMLList", text=COVERAGE),
                ),
            ),
        ),
    )


def _checked(error: Result, judged: Judgement | None) -> Content:
    return _result(
        f"Point {error.name}", error.meaning, _quantity(error, judged), *_expanded(error)
    )
