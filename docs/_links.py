"""Links that lead out of the documentation, to files of the sources: on the site they are the names of those files."""

import re

OUTSIDE = re.compile(r"\[([^\]]*)\]\(\.\./([^)\s]*)\)")


def on_page_markdown(markdown, page, **kwargs):
    """Called by mkdocs with the text of each page."""
    if "/" in page.file.src_uri:
        return markdown
    return OUTSIDE.sub(lambda link: link[1] if link[1].startswith("`") else f"{link[1]} (`{link[2]}`)", markdown)
