"""Command line arguments: options of request classes, the language, and usage errors as messages."""

from __future__ import annotations

import copy
import dataclasses
import difflib
import functools
import inspect
import itertools
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, get_args, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup

from dousa.errors import OptionError
from dousa.messages import LANGUAGES, Message, use_language

_LANGUAGE, _VARIABLE = "--lang", "DOUSA_LANG"
ROOT_OPTIONS = (_LANGUAGE, "--jobs", "-j", "--cluster")
"""What stands before the command, as it goes for all commands."""

Json = Annotated[bool, typer.Option("--json", help="Answer as JSON on standard output.")]
LibraryPath = Annotated[
    str, typer.Argument(metavar="LIB", help="The library: a file such as moves.dousa, or a database URL.")
]
Language = Annotated[
    str | None,
    typer.Option(
        _LANGUAGE,
        metavar="|".join(LANGUAGES),
        help=f"Language of answers and messages. Default: {_VARIABLE}, else the locale.",
    ),
]


def choose_language(words: Sequence[str], environment: Mapping[str, str] = os.environ) -> None:
    """Use the language of ``--lang``, else that of ``DOUSA_LANG``, else that of the locale, from the start on.

    Parameters
    ----------
    words : of the command line. They are searched before they are parsed, so that a mistake among them is described
        in the language too.
    environment : variables.

    Raises
    ------
    OptionError : an unknown language.
    """
    names = ("LC_ALL", "LC_MESSAGES", "LANG")  # the first one that is set decides, as POSIX has it
    locale = next((environment[name] for name in names if environment.get(name)), "")
    use_language(next((language for language in LANGUAGES if locale.lower().startswith(language)), LANGUAGES[0]))
    given = None
    for word, following in itertools.zip_longest(words, words[1:]):
        if word == "--":
            break
        name, _, value = word.partition("=")
        if name == _LANGUAGE and (value or following is not None):
            given = value or following
    if given is not None:
        use_language(_check(_LANGUAGE, given))
    elif environment.get(_VARIABLE):
        use_language(_check(_VARIABLE, environment[_VARIABLE]))


def find_command(words: Sequence[str]) -> str | None:
    """Return the command of a command line; None if something other than options with a value stands before it."""
    for place in range(0, len(words), 2):
        if words[place] not in ROOT_OPTIONS:
            return None if words[place].startswith("-") else words[place]
    return None


def _check(source: str, language: str) -> str:
    if language not in LANGUAGES:
        raise OptionError("usage.unknown_language", source=source, found=language, known=LANGUAGES)
    return language


def to_typer_command(command: Callable[..., None], needed: Sequence[str] = ()) -> Callable[..., None]:
    """Wrap a command for Typer, which wants every option by itself in the signature.

    A parameter whose type is a dataclass, or ``Annotated[dict[str, Any], dataclass]``, stands for the options of its
    fields: those annotated with ``typer.Option``. The command gets their values as an object of the dataclass, or as a
    dictionary where the dataclass has other fields too. Where some are ``needed`` the help has the others under More.
    """
    parameters: list[inspect.Parameter] = []
    groups: list[tuple[str, Callable[..., Any], list[str]]] = []
    signature = inspect.signature(command, eval_str=True)
    for parameter in signature.parameters.values():
        kind = parameter.annotation
        metadata = getattr(kind, "__metadata__", (None,))[0]
        if dataclasses.is_dataclass(kind) or dataclasses.is_dataclass(metadata):
            make: Any = kind if dataclasses.is_dataclass(kind) else dict
            options = _list_options(metadata if make is dict else kind)
            groups.append((parameter.name, make, [option.name for option in options]))
            parameters += options
        else:
            parameters.append(parameter)

    @functools.wraps(command)
    def run(**values: Any) -> None:
        made = {name: make(**{option: values.pop(option) for option in names}) for name, make, names in groups}
        command(**values, **made)

    if needed:
        parameters = [one if one.name in needed else _put_last(one) for one in parameters]
    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    # Typer breaks its lines where the source does.
    run.__doc__ = "\n\n".join(" ".join(part.split()) for part in (inspect.getdoc(command) or "").split("\n\n"))
    return run


def _put_last(parameter: inspect.Parameter) -> inspect.Parameter:
    kind, option = parameter.annotation, getattr(parameter.annotation, "__metadata__", (None,))[0]
    if not isinstance(option, typer.models.OptionInfo):
        return parameter
    moved = copy.copy(option)
    moved.rich_help_panel = "More"
    return parameter.replace(annotation=Annotated[get_args(kind)[0], moved])


_NOT_LOADED = {"ReadOptions": Any, "TrackerSettings": Any}  # types of fields without an option; heavy to import


@functools.cache
def _list_options(group: Any) -> list[inspect.Parameter]:
    hints = get_type_hints(group, localns=_NOT_LOADED, include_extras=True)
    return [
        inspect.Parameter(
            field.name, inspect.Parameter.KEYWORD_ONLY, default=field.default, annotation=hints[field.name]
        )
        for field in dataclasses.fields(group)
        if hasattr(hints[field.name], "__metadata__")
    ]


# Typer brings its own copy of click in newer versions: the classes are had from where its errors are made.
_exceptions: Any = sys.modules[typer.BadParameter.__module__]

UsageError: type[Exception] = _exceptions.UsageError


class Group(TyperGroup):
    """The commands; the error about an unknown one suggests similar names."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        if args and not args[0].startswith("-") and self.get_command(ctx, args[0]) is None:
            similar = difflib.get_close_matches(args[0], self.list_commands(ctx))
            if similar:
                raise OptionError("usage.no_such_command_but", name=args[0], similar=similar)
            raise OptionError("usage.no_such_command", name=args[0])
        return super().resolve_command(ctx, args)


_TAG = "\0"  # no word of a command line holds it


def mark_tags(words: Sequence[str]) -> list[str]:
    """Mark the words ``+fight`` and ``-draft`` of ``dousa tag``, which are no options; see `split_tags`."""
    end = words.index("--") if "--" in words else len(words)
    is_tag = [len(word) > 1 and word[0] in "+-" and word[:2] != "--" and word != "-h" for word in words]
    return [_TAG + word if is_tag[place] and place < end else word for place, word in enumerate(words)]


def split_tags(words: Sequence[str]) -> tuple[list[str], list[str], list[str]]:
    """Split the arguments of ``dousa tag`` into clips, tags to give, and tags to take away."""
    tags = [word[1:] for word in words if word.startswith(_TAG)]
    clips = [word for word in words if not word.startswith(_TAG)]
    return clips, [tag[1:] for tag in tags if tag[0] == "+"], [tag[1:] for tag in tags if tag[0] == "-"]


class Command(TyperCommand):
    """A command whose error names the extra arguments."""

    allow_extra_args = True

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        rest = super().parse_args(ctx, mark_tags(args) if ctx.info_name == "tag" else args)
        if rest and not ctx.resilient_parsing:
            raise OptionError("usage.extra_arguments", found=rest, command=ctx.command_path)
        return rest


def describe_usage(error: Any) -> Message | None:
    """Describe a usage error; None where the help was shown since there were no arguments at all."""
    if isinstance(error, getattr(_exceptions, "NoArgsIsHelpError", ())):
        return None
    problem = _describe(error)
    if error.ctx is None:
        return problem
    return Message("usage.see_help", problem=problem, command=error.ctx.command_path)


def _describe(error: Any) -> Message:
    if isinstance(error, _exceptions.NoSuchOption):
        if error.option_name in ROOT_OPTIONS:
            return Message("usage.before_command", name=error.option_name)
        code = "usage.no_such_option_but" if error.possibilities else "usage.no_such_option"
        return Message(code, name=error.option_name, similar=error.possibilities)
    if isinstance(error, _exceptions.BadOptionUsage):
        return Message("usage.option_without_value", name=error.option_name)
    name = _name(error.param) if getattr(error, "param", None) is not None else None
    if isinstance(error, _exceptions.MissingParameter) and name is not None:
        return Message("usage.missing", name=name)
    if isinstance(error, _exceptions.BadParameter) and name is not None:
        return Message("usage.bad_value", name=name, problem=_describe_value(error))
    return Message("text.verbatim", text=error.format_message())


def _name(parameter: Any) -> str:
    if parameter.param_type_name == "option":
        return str(max(parameter.opts, key=len))
    return str(parameter.metavar or parameter.name.upper())


def _describe_value(error: Any) -> Message:
    """Describe what was expected and what came, from the validation error behind it."""
    details: list[dict[str, Any]] = getattr(error.__cause__, "errors", lambda: [])()
    if not details:  # from a version of Typer that validates otherwise
        return Message("text.verbatim", text=error.message)
    kind, found, limits = details[0]["type"], details[0]["input"], details[0].get("ctx", {})
    choices = getattr(getattr(error.param, "type_descriptor", None), "choices", None)
    if choices:
        return Message("usage.not_a_choice", found=found, choices=[str(choice) for choice in choices])
    if "ge" in limits or "le" in limits:
        code = "usage.too_small" if "ge" in limits else "usage.too_large"
        return Message(code, found=found, limit=limits.get("ge", limits.get("le")))
    whole = kind.startswith("int")
    if not whole and not kind.startswith("float"):
        return Message("text.verbatim", text=error.message)
    return Message("usage.not_a_whole_number" if whole else "usage.not_a_number", found=found)
