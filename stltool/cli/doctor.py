"""`stltool doctor`: what this installation has, what it lacks, and what for."""

from __future__ import annotations

import typer

from stltool.cli.app import app
from stltool.cli.options import AsJson
from stltool.streams import say


@app.command("stltool doctor")
def doctor(as_json: AsJson = False) -> None:
    """Show versions, extras, the cache of compiled kernels and the memory; and what is missing for what.

    Exit code 1 if something that every installation needs is missing, too old or broken. Extras that are not installed
    are listed with the command that installs them, and are no fault.
    """
    from stltool.doctor import PURPOSES, diagnose, in_virtual_environment
    from stltool.reporting.terminal import print_facts, print_json, print_table
    from stltool.sizes import bytes_text

    found = diagnose()
    extras = {
        extra: {
            "for": purpose,
            "packages": [one.name for one in found.packages if one.extra == extra],
            "missing": [one.name for one in found.missing(extra)],
        }
        for extra, purpose in PURPOSES.items()
    }
    if as_json:
        total, available, most = found.memory
        print_json({
            "version": found.version, "python": found.python, "system": found.system, "threads": found.threads,
            "folder": str(found.place), "virtual_environment": in_virtual_environment(),
            "packages": [
                {"name": one.name, "needed": one.needed, "version": one.version, "status": one.status,
                 "extra": one.extra, "fault": one.fault}
                for one in found.packages
            ],
            "extras": extras,
            "cache": {"folder": str(found.cache) if found.cache is not None else None, "kernels": found.kernels},
            "memory": {"total": total, "available": available, "most_used": most},
            "stale": found.stale,
            "faults": found.faults,
        })  # fmt: skip
    else:
        memory = [bytes_text(n) for n in found.memory]
        compiled = f"{found.kernels} compiled" if found.kernels else "compiled when first needed, some seconds"
        print_facts({
            "stltool": f"{found.version}, in {found.place}",
            "Python": f"{found.python}" + (", in a virtual environment" if in_virtual_environment() else ""),
            "system": f"{found.system}, {found.threads} threads",
            "memory": f"{memory[0]}, {memory[1]} of it available; stltool uses up to {memory[2]}",
            "kernels": f"{compiled}; in {found.cache}" if found.cache is not None else "in no folder",
            "a small check": "P = 15/16, as it must be" if found.check is None else found.check,
            **({"note": found.stale} if found.stale is not None else {}),
        })  # fmt: skip
        say()
        print_table([
            {"package": one.name, "needed": one.needed or "any", "installed": one.version or "-",
             "status": one.status if one.fault is None else f"{one.status}: {one.fault}"}
            for one in found.packages if one.extra is None
        ])  # fmt: skip
        say()
        print_table([
            {"extra": extra, "for": about["for"],
             "status": f"missing: pip install 'stltool[{extra}]'" if about["missing"] else "installed"
             if about["packages"] else f"not listed by stltool {found.version} as installed, which is not this code: "
             f"pip install --upgrade 'stltool[{extra}]'"}
            for extra, about in extras.items()
        ])  # fmt: skip
        say()
        print_facts({f"fault {i}": fault for i, fault in enumerate(found.faults, 1)} or {"faults": "none"})
    if found.faults:
        raise typer.Exit(1)
