"""Faults of a built site, links, things from elsewhere, figures in words: `python -m tests.project.site FOLDER`."""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class Page(HTMLParser):
    """What a page links to, what it loads, and where links into it may lead."""

    def __init__(self, text):
        super().__init__()
        self.links, self.loaded, self.anchors, self.words = [], [], set(), "&lt;Figure size" in text
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.anchors |= {given[name] for name in ("id", "name") if given.get(name)}
        if tag == "a" and given.get("href"):
            self.links.append(given["href"])
        if tag == "link" and given.get("rel") in ("stylesheet", "icon", "preload"):
            self.loaded.append(given.get("href"))
        if tag in ("img", "script", "source", "video", "iframe") and given.get("src"):
            self.loaded.append(given["src"])


def faults(folder):
    """One line for each, of all pages in a folder."""
    pages = {
        path: Page(path.read_text(encoding="utf-8"))
        for path in sorted(folder.rglob("*.html"))
        if "_static" not in path.parts
    }
    for path, page in pages.items():
        if page.words:
            yield f"{path}: a figure is there in words alone"
        for link in [*page.links, *page.loaded]:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                if link in page.loaded and parts.scheme != "data":
                    yield f"{path}: loads {link} from elsewhere"
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            known = pages.get(target)
            if not target.exists():
                yield f"{path}: {link} leads nowhere"
            elif parts.fragment and known and unquote(parts.fragment) not in known.anchors:
                yield f"{path}: {link} leads to no place in that page"


if __name__ == "__main__":
    found = list(faults(Path(sys.argv[1]).resolve()))
    print("\n".join(found) or "every link inside the site leads somewhere, and nothing is loaded from elsewhere")
    sys.exit(bool(found))
