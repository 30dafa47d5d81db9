"""--help of every command: what we say in it, not how typer and rich lay it out in this version or that."""

import inspect

from stltool.cli import app
from stltool.cli.steps import LearnerCommand
from stltool.learning.methods import methods_text
from tests.cli.every import COMMANDS


def entries():
    yield "stltool --help", app.info.help
    for name, command in COMMANDS.items():
        lines = [inspect.cleandoc(command.help), ""]
        for parameter in command.params:
            spelled = ", ".join(parameter.opts) if parameter.param_type_name == "option" else parameter.name.upper()
            metavar = f" {parameter.metavar}" if parameter.metavar else ""
            default = parameter.default
            given = (
                "" if default in (None, False) or callable(default) or parameter.required else f" [default: {default}]"
            )
            lines.append(f"{spelled}{metavar}: {parameter.help or ''}{given}")
        lines += ["", command.epilog or ""]
        if isinstance(command, LearnerCommand):
            lines += ["", methods_text()]
        yield f"stltool {name} --help", "\n".join(lines)
