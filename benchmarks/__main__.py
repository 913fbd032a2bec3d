"""Run a benchmark by its name, or list them all.

python -m benchmarks
python -m benchmarks NAME [ARGUMENTS ...]
"""

from __future__ import annotations

import ast
import runpy
import sys
from difflib import get_close_matches
from pathlib import Path

FOLDER = Path(__file__).resolve().parent


def benchmarks() -> dict[str, str]:
    """The first sentence of each script that measures something, by its name."""
    sentences = {}
    for script in sorted(FOLDER.glob("*.py")):
        text = script.read_text(encoding="utf-8")
        if script.stem != "__main__" and 'if __name__ == "__main__"' in text:
            sentences[script.stem] = (ast.get_docstring(ast.parse(text)) or "").split("\n\n")[0].replace("\n", " ")
    return sentences


def main() -> None:
    scripts = benchmarks()
    if len(sys.argv) < 2:
        width = max(map(len, scripts))
        print("\n".join(f"{name:{width}}  {sentence}" for name, sentence in scripts.items()))
        return
    name, *arguments = sys.argv[1:]
    if name not in scripts:
        close = get_close_matches(name, scripts)
        hint = f"did you mean {close[0]}?" if close else "leave the name out to list them"
        print(f"no benchmark is called '{name}'; {hint}", file=sys.stderr)
        sys.exit(2)
    sys.path.insert(0, str(FOLDER))
    sys.argv = [f"{name}.py", *arguments]
    runpy.run_path(str(FOLDER / f"{name}.py"), run_name="__main__")


if __name__ == "__main__":
    main()
