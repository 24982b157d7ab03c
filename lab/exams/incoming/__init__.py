"""The blind exam of what comes in: files with known contents, harmed in known ways, through the doors that a user has.

    python -m lab.exams.incoming [--only KIND] [--json FILE]

Written from the issue, the public pages and the formats' own rules, by somebody who had not seen the readers.
"""

__all__: list[str] = []
