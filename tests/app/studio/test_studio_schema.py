"""The interface under random requests: whatever is asked, nothing is answered with a server error.

Requests are made from the description of the interface by schemathesis; some numbers and names in them are replaced
by real ones, so that what lies behind the checks of the door is reached too. ``DOUSA_FUZZ_EXAMPLES`` says how many
requests there are for each address (16).
"""

import functools
import os
import random
import shutil

import pytest

from app.studio.conftest import TOKEN, wait_for
from dousa.app.studio import Settings, create_app
from dousa.app.studio.jobs.board import JobBoard, Lane

schemathesis = pytest.importorskip("schemathesis", reason="schemathesis is not installed")
EXAMPLES = int(os.environ.get("DOUSA_FUZZ_EXAMPLES", "16"))
HEADERS = {"host": "127.0.0.1:8765", "authorization": f"Bearer {TOKEN}"}


@pytest.fixture(scope="module")
def fuzzed(trained_library, tmp_path_factory):
    """An application with an upload and finished jobs; later jobs are queued and done at once without any work."""
    from starlette.testclient import TestClient

    folder = tmp_path_factory.mktemp("fuzzed")
    library = shutil.copy(trained_library, folder / "moves.dousa")
    bvh = next((trained_library.parent / "motions" / "squat").glob("*.bvh"))
    app = create_app(Settings(library, token=TOKEN))
    client = TestClient(app, "http://127.0.0.1:8765", headers=HEADERS)
    upload = client.post("/api/uploads?name=squat.bvh", content=bvh.read_bytes()).json()
    wanted = {"references": [{"motion": "clip:1"}, {"motion": "clip:2"}], "performance": {"motion": "clip:3"}}
    said = client.post("/api/jobs/evaluate", json=wanted).json()
    jobs = [said["id"]] if "id" in said else []
    for job in jobs:
        wait_for(client, job)
    studio = app.state.studio
    idle = Lane("idle", lambda job, board, stop: {})
    board = JobBoard(studio.workspace, dict.fromkeys(studio.jobs._kinds, idle))
    studio.jobs.close()
    studio.jobs = studio.motions._board = board
    yield (
        app,
        {"batch": [upload["batch"]], "job": jobs, "motion": [upload["files"][0]["motion"], "clip:1", "clip:24"]},
    )
    studio.close()


@functools.cache
def make_schema(app):
    return schemathesis.openapi.from_asgi("/api/openapi.json", app, headers=HEADERS)


def put_real_ones(case, pool, chance):
    """Replace some of what was made up by what is there."""
    for values in (case.path_parameters, case.query, case.body):
        _replace(values, pool, chance)


def _replace(value, pool, chance):
    if isinstance(value, dict):
        for name, inner in value.items():
            kind = {"job_id": "job", "other": "motion", "job": "job"}.get(name, name)
            if kind in pool and pool[kind] and chance.random() < 0.6:
                value[name] = chance.choice(pool[kind])
            elif name in ("clip_id", "id") and chance.random() < 0.6:
                value[name] = chance.randrange(1, 25)
            elif name == "clips" and isinstance(inner, list) and chance.random() < 0.6:
                value[name] = [chance.randrange(1, 25) for _ in inner]
            else:
                _replace(inner, pool, chance)
    elif isinstance(value, list):
        for inner in value:
            _replace(inner, pool, chance)


def operations():
    """Method and path of everything that the description names; made once, to name the tests."""
    from pathlib import Path
    from tempfile import TemporaryDirectory

    with TemporaryDirectory() as name:
        app = create_app(Settings(Path(name) / "empty.dousa", token=TOKEN))
        paths = app.openapi()["paths"]
        app.state.studio.close()
    return [(method, path) for path, methods in paths.items() for method in methods]


@pytest.mark.slow
@pytest.mark.parametrize(("method", "path"), [pytest.param(*one, id=" ".join(one)) for one in operations()])
def test_no_request_is_answered_with_a_server_error(fuzzed, method, path):
    from hypothesis import HealthCheck, Phase, given, settings

    app, pool = fuzzed
    operation = make_schema(app)[path][method.upper()]
    chance = random.Random(f"{method} {path}")

    @given(case=operation.as_strategy())
    @settings(
        max_examples=EXAMPLES,
        derandomize=True,
        deadline=None,
        database=None,
        phases=[Phase.explicit, Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    def ask(case):
        put_real_ones(case, pool, chance)
        answer = case.call(headers=HEADERS)
        assert answer.status_code < 500, f"{answer.status_code} {answer.text[:500]}"
        if answer.status_code >= 400:
            assert answer.json()["problem"]

    ask()


def test_the_library_survived(fuzzed):
    from starlette.testclient import TestClient

    client = TestClient(fuzzed[0], "http://127.0.0.1:8765", headers=HEADERS)
    assert client.get("/api/info").status_code == 200
