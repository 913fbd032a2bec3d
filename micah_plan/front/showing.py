"""A page of the package in a browser or in a notebook."""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from html import escape
from pathlib import Path

from micah_plan.files import replace_file


@dataclass(frozen=True, repr=False)
class Page:
    """A page that needs no network.

    Attributes:
        text: its HTML.
        height: in a notebook [px].
    """

    text: str
    height: int = 620

    def __repr__(self) -> str:
        return f"a page of {len(self.text) // 1024} kB"

    def _repr_html_(self) -> str:
        frame = f'<iframe width="100%" height="{self.height}" style="border:0" srcdoc="'
        return f'{frame}{escape(self.text)}"></iframe>'

    def save(self, path: str | Path) -> None:
        """Write it, at once or not at all."""
        replace_file(path, self.text.encode())

    def opened(self, path: str | Path | None = None) -> Page:
        """The page, written to `path` if one is given, else opened in a browser; a notebook shows it by itself."""
        if path is not None:
            self.save(path)
        elif not _in_notebook():
            import webbrowser

            file = Path(tempfile.mkdtemp(prefix="micah_plan_")) / "page.html"
            self.save(file)
            webbrowser.open(file.as_uri())
        return self


def _in_notebook() -> bool:
    """Whether an IPython kernel runs this, whose front end draws what cells end with."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return hasattr(shell, "kernel")
