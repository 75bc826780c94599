"""Validates parameters with pydantic and reports all mistakes at once.

FastAPI validates routes whose parameters stand in the URL (`Annotated[ListViews, Query()]`), `read` those that take
them as multipart parts too, `validated` JSON.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import islice
from typing import Any, Self, TypeVar, get_args

from pydantic import (
    BaseModel,
    ConfigDict,
    ModelWrapValidatorHandler,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from schemas.errors import MOST_MISTAKES, InvalidParameters, ParameterError
from schemas.values import PATTERNS_IN_WORDS

M = TypeVar("M", bound=BaseModel)


class Parameters(BaseModel):
    """Base of all parameter models: undeclared parameters are refused, and every mistake is listed."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @classmethod
    def gathered(cls, given: Mapping[str, Any]) -> Mapping[str, Any]:
        """The parameters renamed to the fields of the model; for subclasses to override."""
        return given

    @classmethod
    def contradictions(cls, given: Mapping[str, Any]) -> list[ParameterError]:
        """Mistakes between parameters that are each valid; for subclasses to override."""
        return []

    @field_validator("*", mode="before")
    @classmethod
    def _as_numbers_are_written(cls, value: object, info: ValidationInfo) -> object:
        """Refuse 12_5, which Python alone reads as 125."""
        field = cls.model_fields[str(info.field_name)]
        if isinstance(value, str) and "_" in value and _has_numbers(field.annotation):
            raise ValueError("has an underscore, which no number has")
        return value

    @model_validator(mode="wrap")
    @classmethod
    def _all_mistakes(cls, given: Mapping[str, Any], handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Report mistakes of fields together with `contradictions`; pydantic would skip these when a field is wrong."""
        given = cls.gathered(given)
        errors: list[ParameterError] = []
        made: Self | None = None
        try:
            made = handler(given)
        except ValidationError as error:
            errors = problems_of(error, cls)
        errors += cls.contradictions(given)
        if errors or made is None:
            raise _refusal(cls, errors)
        return made


class OnceEach(BaseModel):
    """Refuses repeated parameters.

    FastAPI gives a declared field the last of its repeated values, and undeclared ones as a list of all values.
    """

    @model_validator(mode="before")
    @classmethod
    def _refuse(cls, given: Mapping[str, Any]) -> Mapping[str, Any]:
        if errors := _repeated({name: len(texts) for name, texts in given.items() if isinstance(texts, list)}):
            raise _refusal(cls, errors)
        return {}


def read(model: type[M], pairs: Iterable[tuple[str, str]], already: Sequence[ParameterError] = ()) -> M:
    """Make a model from (name, value) pairs of text.

    Parameters
    ----------
    model : type of Parameters
    pairs : iterable of (str, str)
    already : sequence of ParameterError
        Mistakes found while the request was parsed; they are reported with the others.

    Raises
    ------
    InvalidParameters
        All mistakes at once: unknown, repeated, of a wrong type, out of range, contradicting.
    """
    pairs = list(pairs)
    return validated(model, dict(pairs), [*already, *_repeated(Counter(name for name, _ in pairs))])


def validated(
    model: type[M], given: Mapping[str, Any], already: Sequence[ParameterError] = (), *, strict: bool | None = None
) -> M:
    """Make a model from values by name; raises as `read`. `strict`: no conversion of types, as for JSON."""
    errors = list(already)
    try:
        made = model.model_validate(given, strict=strict)
    except ValidationError as error:
        raise InvalidParameters([*errors, *problems_of(error, model)]) from None
    if errors:
        raise InvalidParameters(errors)
    return made


_IN_WORDS = "parameter"
"""Type of those pydantic errors whose message is used as it is."""

_LONGEST_VALUE_SHOWN = 60


def problems_of(error: ValidationError, model: type[BaseModel]) -> list[ParameterError]:
    """The first errors of a pydantic validation, each with the value given and what is allowed.

    One more than are listed, by which it is seen that there are more.
    """
    known = sorted(str(field.validation_alias or name) for name, field in model.model_fields.items())
    return [in_words(one, one["loc"], known) for one in error.errors(include_url=False)[: MOST_MISTAKES + 1]]


def in_words(one: Mapping[str, Any], path: Sequence[str | int], known: Sequence[str] = ()) -> ParameterError:
    """One error of pydantic's as a ParameterError.

    Parameters
    ----------
    one : mapping
        An entry of ``ValidationError.errors()``.
    path : sequence of str or int
        Location of the error in the parameters.
    known : sequence of str
        Names of all parameters, to list when one is unknown.
    """
    # After the field's name, pydantic's location names the branch of a union that was tried.
    branches = ("function-", "tuple[")
    name = ".".join(str(part) for i, part in enumerate(path) if i == 0 or not str(part).startswith(branches))
    if one["type"] == _IN_WORDS:
        detail = one["msg"]
    elif one["type"] == "extra_forbidden":
        nested = "is unknown" if len(path) > 1 else "is unknown; none is taken here"
        detail = f"is unknown; known are {', '.join(known)}" if known and len(path) == 1 else nested
    elif one["type"] == "missing":
        detail = "is required"
    elif one["type"] == "string_pattern_mismatch" and one["ctx"]["pattern"] in PATTERNS_IN_WORDS:
        detail = f"{PATTERNS_IN_WORDS[one['ctx']['pattern']]} (got {_shown(one['input'])})"
    elif one["type"] == "too_long" and isinstance(one["input"], str):
        # pydantic counts items where text went through a validator of ours.
        detail = f"needs at most {one['ctx']['max_length']} characters (got {_shown(one['input'])})"
    else:
        detail = f"{one['msg'].removeprefix('Value error, ')} (got {_shown(one['input'])})"
    return ParameterError(name, detail)


def _has_numbers(annotation: object) -> bool:
    return annotation in (int, float) or any(map(_has_numbers, get_args(annotation)))


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= _LONGEST_VALUE_SHOWN else f"{text[:_LONGEST_VALUE_SHOWN]}…"


def _repeated(times: Mapping[str, int]) -> list[ParameterError]:
    return [ParameterError(name, f"was given {count} times") for name, count in times.items() if count > 1]


def _refusal(model: type[BaseModel], errors: Iterable[ParameterError]) -> ValidationError:
    """The mistakes as a pydantic error, so that FastAPI and `validated` report them like those of fields."""
    lines = [
        InitErrorDetails(
            type=PydanticCustomError(_IN_WORDS, "{detail}", {"detail": one.detail}), loc=(one.parameter,), input=None
        )
        for one in islice(errors, MOST_MISTAKES + 1)
    ]
    return ValidationError.from_exception_data(model.__name__, lines)
