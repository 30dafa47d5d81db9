"""Writes docs/reports.schema.json: the JSON that stltool writes, from the classes in stltool/reporting/records.py.

python docs/schema.py            tests/reporting/test_records.py fails if the file is not what this writes
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec

from stltool.reporting.records import FORMATS, OUTPUTS

SCHEMA = Path(__file__).with_name("reports.schema.json")


def schema() -> dict[str, Any]:
    """JSON Schema 2020-12: the whole is a file with a `format`, `$defs` has every record, `commands` what each prints.

    No record has other fields than those listed. A version (the number that ends a format) may add fields; a field that
    is removed, renamed or changes its meaning makes another version.
    """
    kinds = [*FORMATS.values(), *OUTPUTS.values()]
    _, defined = msgspec.json.schema_components(kinds, ref_template="#/$defs/{name}")
    for record in defined.values():
        record["additionalProperties"] = False
        if "description" in record:
            record["description"] = " ".join(record["description"].split())
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "What stltool writes",
        "description": "Files with results, by their format; what commands print with --json is under commands.",
        "oneOf": [{"$ref": f"#/$defs/{record.__name__}"} for record in FORMATS.values()],
        "commands": {command: {"$ref": f"#/$defs/{record.__name__}"} for command, record in OUTPUTS.items()},
        "$defs": dict(sorted(defined.items())),
    }


def text() -> str:
    """The schema as the file has it."""
    return json.dumps(schema(), indent=1) + "\n"


if __name__ == "__main__":
    SCHEMA.write_text(text(), encoding="utf-8")
