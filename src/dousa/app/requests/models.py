"""Models of the studio's interface from request classes."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Collection
from typing import Any, get_args, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, create_model

_NOT_LOADED = {"ReadOptions": Any, "TrackerSettings": Any}  # types of fields that no model has


def derive_model(request: Any, only: Collection[str] | None = None) -> Any:
    """Make a pydantic model with the fields of a request: their types, defaults, limits and descriptions.

    Parameters
    ----------
    request : dataclass whose fields may be annotated with ``typer.Option``, which has limits and description.
    only : names of the fields; all by default.
    """
    hints = get_type_hints(request, localns=_NOT_LOADED, include_extras=True)
    fields: dict[str, Any] = {}
    for field in dataclasses.fields(request):
        if only is not None and field.name not in only:
            continue
        option = next(iter(getattr(hints[field.name], "__metadata__", ())), None)
        kind = hints[field.name] if option is None else get_args(hints[field.name])[0]
        limits: dict[str, Any] = {"description": _describe(option)}
        if kind in (str, str | None):
            limits["max_length"] = 1000
        else:
            limits |= {"allow_inf_nan": False} if float in (kind, *get_args(kind)) else {}
            limits |= {"ge": getattr(option, "min", None), "le": getattr(option, "max", None)}
        fields[field.name] = (kind, Field(default=field.default, **limits))
    base = create_model(request.__name__, __config__=ConfigDict(extra="forbid"), **fields)
    base.__doc__ = request.__doc__
    return base


def _describe(option: Any) -> str | None:
    """Return the help of an option in the names of fields, and its default where the command line says it in words."""
    text = getattr(option, "help", None)
    if text is None:
        return None
    default = getattr(option, "show_default", None)
    text += f" Default: {default}." if isinstance(default, str) else ""
    return re.sub(r"--([a-z][a-z-]*)", lambda name: name[1].replace("-", "_"), text)


def pick_fields(model: BaseModel, request: Any) -> dict[str, Any]:
    """Take the values of the fields that a model has from a request."""
    return model.model_dump(include={field.name for field in dataclasses.fields(request)})
