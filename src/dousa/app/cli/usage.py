"""Command line arguments: their groups, the language they select, and usage errors as errors of ours."""

from __future__ import annotations

import dataclasses
import difflib
import functools
import inspect
import itertools
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup

from dousa.errors import OptionError
from dousa.messages import LANGUAGES, Message, use_language

_OPTION, _VARIABLE = "--lang", "DOUSA_LANG"


def _use_given(language: str | None) -> None:
    if language is not None:
        use_language(_check(_OPTION, language))


Language = Annotated[
    str | None,
    typer.Option(
        _OPTION,
        metavar="|".join(LANGUAGES),
        callback=_use_given,
        is_eager=True,
        help=f"Language of answers and messages. Default: {_VARIABLE}, else the locale.",
    ),
]


def choose_language(words: Sequence[str], environment: Mapping[str, str] = os.environ) -> None:
    """Speak the language of ``--lang``, else that of ``DOUSA_LANG``, else that of the locale, from the start on.

    Parameters
    ----------
    words : of the command line. They are looked through before they are understood, so that a mistake among them is
        described in the language too.
    environment : variables.

    Raises
    ------
    OptionError : a language that there is not.
    """
    names = ("LC_ALL", "LC_MESSAGES", "LANG")  # the first one that is set decides, as POSIX has it
    locale = next((environment[name] for name in names if environment.get(name)), "")
    use_language(next((language for language in LANGUAGES if locale.lower().startswith(language)), LANGUAGES[0]))
    given = None
    for word, following in itertools.zip_longest(words, words[1:]):
        if word == "--":
            break
        name, _, value = word.partition("=")
        if name == _OPTION and (value or following is not None):
            given = value or following
    if given is not None:
        use_language(_check(_OPTION, given))
    elif environment.get(_VARIABLE):
        use_language(_check(_VARIABLE, environment[_VARIABLE]))


def _check(source: str, language: str) -> str:
    if language not in LANGUAGES:
        raise OptionError("usage.unknown_language", source=source, found=language, known=LANGUAGES)
    return language


def to_typer_command(command: Callable[..., None]) -> Callable[..., None]:
    """The command as Typer wants it: every option in the signature by itself, and ``--lang``, which is used before it
    runs.

    A parameter of the command whose type is a dataclass is a group of options, spelled once for all commands that have
    it: the options of its fields stand in its place in the signature, and the command gets them in one object.
    """
    parameters: list[inspect.Parameter] = []
    groups: list[tuple[str, Callable[..., Any], list[str]]] = []
    signature = inspect.signature(command, eval_str=True)
    for parameter in signature.parameters.values():
        if dataclasses.is_dataclass(parameter.annotation):
            group: Any = parameter.annotation
            options = _list_options(group)
            groups.append((parameter.name, group, [option.name for option in options]))
            parameters += options
        else:
            parameters.append(parameter)
    parameters.append(_option("lang", Language, None))

    @functools.wraps(command)
    def run(*, lang: str | None = None, **values: Any) -> None:
        made = {name: kind(**{option: values.pop(option) for option in names}) for name, kind, names in groups}
        command(**values, **made)

    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    # Typer breaks its lines where the source does.
    run.__doc__ = "\n\n".join(" ".join(part.split()) for part in (inspect.getdoc(command) or "").split("\n\n"))
    return run


@functools.cache
def _list_options(group: Any) -> list[inspect.Parameter]:
    hints = get_type_hints(group, include_extras=True)
    return [_option(field.name, hints[field.name], field.default) for field in dataclasses.fields(group)]


def _option(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


# Typer brings its own copy of click in newer versions: the classes are had from where its errors are made.
_exceptions: Any = sys.modules[typer.BadParameter.__module__]

UsageError: type[Exception] = _exceptions.UsageError


class Group(TyperGroup):
    """The commands; one that there is not is said with those of a similar name."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        if args and not args[0].startswith("-") and self.get_command(ctx, args[0]) is None:
            similar = difflib.get_close_matches(args[0], self.list_commands(ctx))
            if similar:
                raise OptionError("usage.no_such_command_but", name=args[0], similar=similar)
            raise OptionError("usage.no_such_command", name=args[0])
        return super().resolve_command(ctx, args)


def spell_tags(words: Sequence[str]) -> list[str]:
    """The words of ``dousa tag`` with ``+fight`` and ``-draft`` as ``--add=fight`` and ``--take=draft``."""
    spelled: list[str] = []
    for place, word in enumerate(words):
        if word == "--":
            return [*spelled, *words[place:]]
        is_option = word.startswith("--") or word in ("-", "-h")
        option = "" if is_option or len(word) < 2 else {"+": "--add=", "-": "--take="}.get(word[0], "")
        spelled.append(option + word[1:] if option else word)
    return spelled


class Command(TyperCommand):
    """A command that names the arguments which are too many."""

    allow_extra_args = True

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        rest = super().parse_args(ctx, spell_tags(args) if ctx.info_name == "tag" else args)
        if rest and not ctx.resilient_parsing:
            raise OptionError("usage.extra_arguments", found=rest, command=ctx.command_path)
        return rest


def describe_usage(error: Any) -> Message | None:
    """What is wrong in a command; None where it has no arguments at all and its help was shown instead."""
    if isinstance(error, getattr(_exceptions, "NoArgsIsHelpError", ())):
        return None
    problem = _describe(error)
    if error.ctx is None:
        return problem
    return Message("usage.see_help", problem=problem, command=error.ctx.command_path)


def _describe(error: Any) -> Message:
    if isinstance(error, _exceptions.NoSuchOption):
        if error.possibilities:
            return Message("usage.no_such_option_but", name=error.option_name, similar=error.possibilities)
        return Message("usage.no_such_option", name=error.option_name)
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
    """What was expected and what came, from the error of the validation behind it."""
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
