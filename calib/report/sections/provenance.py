"""Where the result comes from, and how to make it again."""

from __future__ import annotations

from calib.report.blocks import (
    Block,
    Chapter,
    CommandLine,
    DefinitionList,
    Paragraph,
    Text,
    table,
    words,
)
from calib.report.context import ReportContext
from calib.report.numbers import decimals
from calib.results.calibration import Calibration


def provenance(c: Calibration, context: ReportContext) -> Chapter:
    """Write the provenance."""
    made = context.made
    facts: tuple[tuple[Text, Text], ...] = (
        ("Finished", made.finished),
        ("calib", f"{made.version}, commit {made.commit}"),
        ("Python", f"{made.python} on {made.system}"),
        ("Dataset", c.name),
        ("SHA-256 of the dataset", c.sha256),
        ("Seed of all random numbers", str(c.seed)),
    )
    packages = [(words(name), words(version)) for name, version in sorted(made.packages.items())]
    blocks: list[Block] = [
        Paragraph(
            "The same dataset, seed and versions give the same calibration.json, byte for byte. "
            "results.h5 holds every array, run.toml what stands here. This page needs no network."
        ),
        DefinitionList(facts),
        Paragraph("To make it again:"),
        CommandLine(made.command),
    ]
    if made.durations_s:
        durations = [(words(name), decimals(t, 2)) for name, t in made.durations_s.items()]
        blocks.append(
            table(
                "Duration of the stages that ran",
                ("Stage", "Duration / s"),
                durations,
                note="Stages whose inputs had not changed were reused.",
            )
        )
    blocks.append(table("Packages", ("Package", "Version"), packages))
    return Chapter("provenance", "Provenance", tuple(blocks))
