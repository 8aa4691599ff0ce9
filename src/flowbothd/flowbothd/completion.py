"""`flowbothd completion`: a script that lets the shell complete commands, options and choices."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import shlex
import sys
from collections.abc import Sequence

SHELLS = ("bash", "zsh")

_SCRIPT = """# Completion of flowbothd for {shell}; made by `flowbothd completion {shell}`.
{prologue}_flowbothd() {{
  local current="${{COMP_WORDS[COMP_CWORD]}}" before="${{COMP_WORDS[COMP_CWORD-1]}}" words=""
  local command="${{COMP_WORDS[1]}}"
  case "$command" in
    {groups}) [ "$COMP_CWORD" -gt 2 ] && command="$command ${{COMP_WORDS[2]}}" ;;
  esac
  [ "$COMP_CWORD" -eq 1 ] && command=""
  case "$command $before" in
{choices}
    *) case "$command" in
{options}
    esac ;;
  esac
  COMPREPLY=($(compgen -W "$words" -- "$current"))
  [ "${{#COMPREPLY[@]}}" -eq 0 ] && COMPREPLY=($(compgen -f -- "$current"))
}}
complete -F _flowbothd flowbothd
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `flowbothd completion`."""
    parser.add_argument("shell", choices=SHELLS)


def run(arguments: argparse.Namespace) -> int:
    """Print the script."""
    from flowbothd.cli import COMMANDS

    sys.stdout.write(script(arguments.shell, [(c.name, c.module) for c in COMMANDS]))
    return 0


def script(shell: str, commands: Sequence[tuple[str, str]]) -> str:
    """The script of a shell.

    Args:
        shell: bash or zsh.
        commands: Name and module of each; the modules are imported here, so that completing
            itself imports nothing.
    """
    groups = sorted({name.split()[0] for name, _ in commands if " " in name})
    firsts = sorted({name.split()[0] for name, _ in commands})
    options = [_case("", [*firsts, "--help", "--version"])]
    choices = []
    for group in groups:
        options.append(
            _case(group, [n.split()[1] for n, _ in commands if n.startswith(f"{group} ")])
        )
    for name, module in commands:
        parser = argparse.ArgumentParser(add_help=True)
        # A command whose optional dependency is not here still completes by its name.
        with contextlib.suppress(ImportError):
            importlib.import_module(module).add_arguments(parser)
        found = [word for action in parser._actions for word in action.option_strings]
        for action in parser._actions:
            if action.choices and action.option_strings:
                values = [str(choice) for choice in action.choices]
                choices += [_case(f"{name} {word}", values) for word in action.option_strings]
            elif action.choices:
                found += [str(choice) for choice in action.choices]
        options.append(_case(name, found))
    return _SCRIPT.format(
        shell=shell,
        prologue="autoload -U +X bashcompinit && bashcompinit\n" if shell == "zsh" else "",
        groups="|".join(groups),
        choices="\n".join(choices),
        options="\n".join(options),
    )


def _case(pattern: str, words: Sequence[str]) -> str:
    return f"    {shlex.quote(pattern)}) words={shlex.quote(' '.join(words))} ;;"
