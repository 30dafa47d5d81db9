"""Golden files: what stltool says to its users, one file a kind, compared word by word.

    python -m tests.golden.renew            write all of them again
    python -m tests.golden.renew options    one of them

The diff of these files shows what a change does to help texts, messages, terminal output and pages.
"""
