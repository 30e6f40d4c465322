"""The HTML report: from rows to one self-contained page."""
