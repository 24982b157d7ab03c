"""The example gallery: a page for each script of docs/examples, with what it prints and the picture it draws.

A hook of MkDocs; the scripts are run when the site is built, and one that fails, fails the build.
"""

from __future__ import annotations

from collections.abc import Iterable

from examples import Example, ExampleError, Outcome, read_examples, run_examples
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import BuildError
from mkdocs.structure.files import File, Files

_WIDE = "---\nhide: [toc]\n---\n"  # room for the lines of a script


def write_page(example: Example, outcome: Outcome) -> str:
    """The page of an example in Markdown."""
    parts = [_WIDE, f"# {example.title}", example.text, f"![{example.title}]({example.name}.png)"]
    if outcome.printed.strip():
        parts += ["It prints:", f"```text\n{outcome.printed.rstrip()}\n```"]
    parts += [f'```python title="{example.path.name}"\n{example.code}\n```']
    return "\n\n".join(part for part in parts if part) + "\n"


def write_index(examples: Iterable[Example]) -> str:
    """The page that shows all examples."""
    cards = [
        f'<a href="{example.name}.html"><img src="{example.name}.png" alt=""><span>{example.title}</span></a>'
        for example in examples
    ]
    return "\n".join(
        [
            _WIDE,
            "# Examples",
            "",
            "Short scripts that need nothing but the package: the motions are made by `dousa.motion.synthetic`.",
            "Each was run when this page was built. Copy one, and put your own files in the place of the made-up ones.",
            "",
            '<div class="gallery">',
            *cards,
            "</div>",
        ]
    )


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put the pages of the examples below their overview."""
    for entry in config.nav or []:
        if isinstance(entry, dict) and entry.get("Examples") == ["gallery/index.md"]:
            entry["Examples"] += [{one.title: f"gallery/{one.name}.md"} for one in read_examples()]
    return config


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Run the examples, add their pages and pictures."""
    try:
        examples = read_examples()
        outcomes = run_examples(examples)
    except ExampleError as error:
        raise BuildError(str(error)) from error
    for example, outcome in zip(examples, outcomes, strict=True):
        page = write_page(example, outcome)
        files.append(File.generated(config, f"gallery/{example.name}.md", content=page))
        files.append(File.generated(config, f"gallery/{example.name}.png", content=outcome.picture))
    files.append(File.generated(config, "gallery/index.md", content=write_index(examples)))
    return files
