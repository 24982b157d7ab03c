"""``--body``, ``--stature`` and ``--sex``: whose body is tracked or drawn."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from dousa.errors import BodyModelError, OptionError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dousa.app._estimation_start import StartPose
    from dousa.app._output import ProgressCallback
    from dousa.app.estimating import Request
    from dousa.estimation import BodyModel, Camera
    from dousa.estimation.silhouettes import Mask
    from dousa.library import ReadOptions

__all__ = ["choose_body", "load_body", "load_given_body", "measure_body"]

_USUAL = 1.72
_AGREES = 0.07  # of the stature: a start further off is of somebody else, or of a skeleton with other joints


def choose_body(
    request: Request, said: StartPose | None, known_stature: float | None
) -> tuple[BodyModel, str, tuple[str, ...]]:
    """The body to be tracked: of ``--body`` or the tables, with the limbs of the start where ``--bones`` asks for it.

    Parameters
    ----------
    request : its ``body``, ``stature``, ``sex`` and ``bones`` count.
    said : the joints of the start.
    known_stature : m, what the silhouettes' file says.

    Returns
    -------
    The body, what it was made from in words, and what a person should know.

    Raises
    ------
    OptionError : bones of a start that is not given.
    DousaError : see `load_body`.
    """
    from dousa.estimation._body_from_skeleton import fit_body

    if request.bones == "start" and said is None:
        raise OptionError("--bones start needs --start FILE:FRAME, whose joints tell how long the limbs are")
    body, words, notes = load_body(
        request.body, request.stature, request.sex, known_stature=known_stature, options=request.options
    )
    if said is None or request.bones == "tables" or (request.bones == "auto" and request.body is not None):
        return body, words, notes
    try:
        fitted = fit_body(body, said.positions)
    except BodyModelError:
        if request.bones == "start":
            raise
        return body, f"{words}, limbs by the tables (the start does not tell them)", notes
    if request.body is None and request.stature is None and known_stature is None:
        return fitted, f"limbs of the start, stature {fitted.stature:.2f} m by them", ()
    if request.bones == "auto" and abs(fitted.stature / body.stature - 1.0) > _AGREES:
        said_words = f"the start's would be {fitted.stature:.2f} m tall; --bones start takes them"
        return body, f"{words}, limbs by the tables ({said_words})", notes
    return fitted, f"{words}, limbs of the start", notes


def measure_body(
    sex: str, cameras: Sequence[Camera], masks: Sequence[Mask | None], progress: ProgressCallback
) -> tuple[BodyModel, str, tuple[str, ...]]:
    """The body where nobody says how tall it is: several views of the first frame tell it, one does not.

    Returns
    -------
    As `choose_body`.
    """
    from dousa.errors import SilhouetteError
    from dousa.estimation.human import make_human
    from dousa.estimation.scale import fit_scale

    note = (
        f"no --stature and no --body: a stature of {_USUAL} m is assumed; give --stature M for better results"
    )
    try:
        scale = fit_scale(
            cameras, masks, make_body=lambda stature: make_human(stature, sex), progress=progress
        )
    except SilhouetteError:  # nobody in the first frame
        return make_human(_USUAL, sex), f"stature {_USUAL} m, assumed", (note,)
    if not scale.told:
        return make_human(_USUAL, sex), f"stature {_USUAL} m, assumed", (note,)
    return make_human(scale.stature, sex), f"stature {scale.stature:.2f} m, told by the silhouettes", ()


def load_body(
    file: Path | None,
    stature: float | None,
    sex: str,
    *,
    known_stature: float | None,
    options: ReadOptions,
) -> tuple[BodyModel, str, tuple[str, ...]]:
    """The body that the options ask for.

    Parameters
    ----------
    file : a body file (TOML), or a motion file with the person's bones.
    stature : m.
    sex : for the proportions, where there is no file.
    known_stature : m, what the silhouettes' file says; used when neither is given.
    options : how a motion file is read.

    Returns
    -------
    The body, what it was made from in words, and what a person should know.

    Raises
    ------
    OptionError : both a file and a stature.
    DousaError : a file that is no body, a stature no person has.
    """
    if file is not None and stature is not None:
        raise OptionError("--body and --stature exclude each other: the body file says how tall it is")
    if file is not None:
        body, notes = load_given_body(file, options)
        return body, str(file), notes
    from dousa.estimation.human import make_human

    chosen = stature if stature is not None else known_stature
    if chosen is not None:
        said = "given" if stature is not None else "said by the silhouettes' file"
        return make_human(chosen, sex), f"stature {chosen:.2f} m, {said}", ()
    note = (
        f"no --stature and no --body: a stature of {_USUAL} m is assumed; give --stature M for better results"
    )
    return make_human(_USUAL, sex), f"stature {_USUAL} m, assumed", (note,)


def load_given_body(file: Path, options: ReadOptions) -> tuple[BodyModel, tuple[str, ...]]:
    """The body of a TOML file, or with the bones of a motion file.

    Raises
    ------
    DousaError : the file is no body.
    """
    from dousa.formats import SUFFIXES, read_motion

    if file.suffix.lower() not in SUFFIXES:
        from dousa.estimation.body_file import read_body

        return read_body(file), ()
    from dousa.estimation._body_from_skeleton import body_from_motion

    skeleton = options.skeleton if file.suffix.lower() == ".amc" else None
    motion = read_motion(file, unit=options.unit, up=options.up, skeleton=skeleton)
    body = body_from_motion(motion)
    return body, (f"{file}: a body with the bones of this motion, stature {body.stature:.2f} m",)
