"""Makes models of parameters, and lists every mistake at once, in our words.

FastAPI does it for routes whose parameters stand in the URL (`Annotated[ListViews, Query()]`), `read` for those that
take them as multipart parts too, `validated` for JSON.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Self, TypeVar

from pydantic import BaseModel, ConfigDict, ModelWrapValidatorHandler, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from schemas.errors import InvalidParameters, ParameterError

M = TypeVar("M", bound=BaseModel)


class Parameters(BaseModel):
    """Base of all: what is not declared is refused, and every mistake is listed."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @classmethod
    def gathered(cls, given: Mapping[str, Any]) -> Mapping[str, Any]:
        """What was written, by the names of the fields."""
        return given

    @classmethod
    def contradictions(cls, given: Mapping[str, Any]) -> list[ParameterError]:
        """What parameters that may each be fine say against one another."""
        return []

    @model_validator(mode="wrap")
    @classmethod
    def _all_mistakes(cls, given: Mapping[str, Any], handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Mistakes of fields and contradictions between them together; pydantic alone would stop after the first."""
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

    FastAPI gives the fields of a model the last of repeated values; what is no field it gives as a list of all of them.
    """

    @model_validator(mode="before")
    @classmethod
    def _refuse(cls, given: Mapping[str, Any]) -> Mapping[str, Any]:
        if errors := _repeated({name: len(texts) for name, texts in given.items() if isinstance(texts, list)}):
            raise _refusal(cls, errors)
        return {}


def read(model: type[M], pairs: Iterable[tuple[str, str]], already: Sequence[ParameterError] = ()) -> M:
    """Make a model of parameters as they were written.

    Parameters
    ----------
    already : sequence of ParameterError
        Mistakes found while the request was taken apart; they are listed with the others.

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
    """Make a model of values; raises InvalidParameters as `read`."""
    errors = list(already)
    try:
        made = model.model_validate(given, strict=strict)
    except ValidationError as error:
        raise InvalidParameters([*errors, *problems_of(error, model)]) from None
    if errors:
        raise InvalidParameters(errors)
    return made


_IN_WORDS = "parameter"
"""Type of pydantic's errors whose message is ours."""

_LONGEST_VALUE_SHOWN = 60


def problems_of(error: ValidationError, model: type[BaseModel]) -> list[ParameterError]:
    """pydantic's findings in our words: the value that was seen, and what is allowed."""
    known = sorted(str(field.validation_alias or name) for name, field in model.model_fields.items())
    return [in_words(one, one["loc"], known) for one in error.errors(include_url=False)]


def in_words(one: Mapping[str, Any], path: Sequence[str | int], known: Sequence[str] = ()) -> ParameterError:
    """One finding of pydantic's in our words.

    Parameters
    ----------
    one : mapping
        An entry of ``ValidationError.errors()``.
    path : sequence of str or int
        Where in the parameters it is.
    known : sequence of str
        Names that would have been known instead of an unknown one.
    """
    # Behind a field's name pydantic names the branch of a union that it tried.
    branches = ("function-", "tuple[")
    name = ".".join(str(part) for i, part in enumerate(path) if i == 0 or not str(part).startswith(branches))
    if one["type"] == _IN_WORDS:
        detail = one["msg"]
    elif one["type"] == "extra_forbidden":
        detail = f"is unknown; known are {', '.join(known)}" if known else "is unknown; none is taken here"
    elif one["type"] == "missing":
        detail = "is required"
    else:
        detail = f"{one['msg'].removeprefix('Value error, ')} (got {_shown(one['input'])})"
    return ParameterError(name, detail)


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= _LONGEST_VALUE_SHOWN else f"{text[:_LONGEST_VALUE_SHOWN]}…"


def _repeated(times: Mapping[str, int]) -> list[ParameterError]:
    return [ParameterError(name, f"was given {count} times") for name, count in times.items() if count > 1]


def _refusal(model: type[BaseModel], errors: Iterable[ParameterError]) -> ValidationError:
    """Mistakes as pydantic raises them, so that whoever made the model collects them with others."""
    lines = [
        InitErrorDetails(
            type=PydanticCustomError(_IN_WORDS, "{detail}", {"detail": one.detail}), loc=(one.parameter,), input=None
        )
        for one in errors
    ]
    return ValidationError.from_exception_data(model.__name__, lines)
