"""`calib completion`: a script by which bash or zsh complete commands, options and files."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable

SHELLS = ("bash", "zsh")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("shell", choices=SHELLS, metavar="SHELL", help="bash or zsh")


def run(arguments: argparse.Namespace) -> int:
    """Print the script."""
    import shtab

    build: Callable[[], argparse.ArgumentParser] = arguments.whole_parser
    whole = build()
    _name_commands(whole)
    sys.stdout.write(shtab.complete(whole, shell=arguments.shell))
    return 0


def _name_commands(parser: argparse.ArgumentParser) -> None:
    """Give each command a line of help: shtab passes over those without.

    In the help of `calib` itself they would stand twice.
    """
    for action in parser._actions:
        if not isinstance(action, argparse._SubParsersAction):
            continue
        named = {choice.dest for choice in action._choices_actions}
        for name, child in action.choices.items():
            if name not in named:
                line = action._ChoicesPseudoAction(name, [], child.description or name)
                action._choices_actions.append(line)
            _name_commands(child)
