"""Shared fixtures: real recordings are read in place and tests skip with a message where they are absent."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from dousa.kernels import compile_always
from one_compiler import compile_in_turns
from processor_times import ProcessorTimes
from submission import DOCUMENTS, JOBS

os.environ["DOUSA_LANG"] = "en"  # whatever the locale of the machine is; commands in processes of their own inherit it
# A loaded machine is slow, not wrong; CI tries the same examples each time, whoever works at it tries new ones.
settings.register_profile(
    "dousa",
    max_examples=100 if "NIGHTLY" in os.environ else 40,
    deadline=None,
    derandomize="CI" in os.environ,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("dousa")

ROOT = Path(__file__).resolve().parent
DEAR = tomllib.loads((ROOT / "tests/dear.toml").read_text(encoding="utf-8"))
SHARED_DATA = ROOT.parent / "shared" / "data"


def pytest_configure(config: pytest.Config) -> None:
    """Workers compile in turns, by files in the folder where their temporary ones are; what tests cost can be told."""
    compile_always()  # what is tried is the compiled code; that small work is interpreted has tests of its own
    if hasattr(config, "workerinput"):
        compile_in_turns(Path(config.option.basetemp).parent / "kernels")
    if count := int(os.environ.get("DOUSA_TEST_TIMES", "0")):
        config.pluginmanager.register(ProcessorTimes(count), "processor times")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests of pages, of documents and of the lab are known by their fixture and their folder."""
    jobs = {(ROOT / "tests/app" / file, name) for file, names in JOBS.items() for name in names}
    for item in items:
        nightly = item.path.is_relative_to(ROOT / "lab") or item.get_closest_marker("slow") is not None
        name = item.nodeid.partition("[")[0]
        names = {name, name.rpartition("::")[0]}
        nightly |= not names.isdisjoint(DEAR["nightly"])
        if not names.isdisjoint(DEAR["submission"]):
            item.add_marker(pytest.mark.dear)
        if "browser" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.browser)
            item.add_marker(pytest.mark.flaky(reruns=1))  # what passes only then is printed by its name
            nightly |= (item.path, getattr(item, "originalname", "")) not in jobs
        nightly |= "firefox" in getattr(item, "fixturenames", ())
        if item.path.is_relative_to(ROOT / "tests" / "documents"):
            item.add_marker(pytest.mark.documents)
            nightly |= item.name not in DOCUMENTS and getattr(item, "originalname", "") not in DOCUMENTS
        if nightly:
            item.add_marker(pytest.mark.nightly)


@pytest.fixture(scope="session")
def shared_data() -> Callable[[str], Path]:
    """Path of a recording below ../shared/data; skips the test where it is absent."""

    def find(relative: str) -> Path:
        path = SHARED_DATA / relative
        if not path.exists():
            pytest.skip(f"no recordings at ../shared/data/{relative}")
        return path

    return find


@pytest.fixture(scope="session")
def foreign(shared_data: Callable[[str], Path]) -> Callable[[str], Path]:
    """Path of a file by another producer, below ../shared/data/foreign; skips the test where it is absent."""
    return lambda relative: shared_data(f"foreign/{relative}")
