"""Unions of spec models discriminated by ``kind``, open to models registered later."""

import re
from collections.abc import Iterable, Iterator, Mapping
from functools import reduce
from operator import or_
from typing import Annotated, Any, Generic, TypeVar, get_args, get_origin

from pydantic import BaseModel, Field, TypeAdapter
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, core_schema

from dslab.scenarios.strict import Strict

ModelT = TypeVar("ModelT", bound=Strict)
_KIND = re.compile(r"[a-z][a-z0-9_]*")


class Kinds(Mapping[str, type[ModelT]], Generic[ModelT]):
    """Models by kind, and the pydantic type of a value that is one of them.

    As metadata of an ``Annotated`` type it validates by the models registered at that moment, with the same
    faults and the same JSON Schema as a union discriminated by ``kind``.

    Args:
        noun: name of the part, for messages.
        models: the models to begin with, each with a literal ``kind``.
    """

    def __init__(self, noun: str, models: Iterable[type[ModelT]]) -> None:
        self._noun = noun
        self._models = {kind_of(model): model for model in models}
        self._adapter: TypeAdapter[ModelT] | None = None

    def add(self, model: type[ModelT]) -> str:
        """Register one more model.

        Args:
            model: with a field ``kind: Literal["name"]``.

        Returns:
            Its kind.

        Raises:
            ValueError: the model has no literal kind, or its kind is taken by another one.
        """
        kind = kind_of(model)
        if self._models.get(kind, model) is not model:
            raise ValueError(f"there is a {self._noun} of kind {kind!r} already: name yours differently")
        self._models[kind] = model
        self._adapter = None
        return kind

    def remove(self, kind: str) -> None:
        """Take a registered model out again."""
        del self._models[kind]
        self._adapter = None

    def __getitem__(self, kind: str) -> type[ModelT]:
        return self._models[kind]

    def __iter__(self) -> Iterator[str]:
        return iter(self._models)

    def __len__(self) -> int:
        return len(self._models)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self._validate)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: Any) -> dict[str, Any]:
        return handler(self._union().core_schema)

    def _validate(self, value: Any) -> ModelT:
        return self._union().validate_python(value)

    def _union(self) -> TypeAdapter[ModelT]:
        if self._adapter is None:
            models = reduce(or_, self._models.values())
            union = Annotated[models, Field(discriminator="kind")]  # pyright: ignore[reportInvalidTypeForm]
            self._adapter = TypeAdapter(union)
        return self._adapter


def kind_of(model: type[Strict]) -> str:
    """The kind of a model, from its field ``kind: Literal["name"]``.

    Raises:
        ValueError: there is no such field, or the name is not in small letters, digits and underscores.
    """
    field = model.model_fields.get("kind")
    names = get_args(field.annotation) if field else ()
    if len(names) != 1 or not isinstance(names[0], str) or not _KIND.fullmatch(names[0]):
        raise ValueError(f'{model.__name__} needs a field kind: Literal["name"], in small letters')
    return names[0]


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Every model of a spec that a type, a field or an open union names."""
    if isinstance(annotation, FieldInfo):
        open_unions = [entry for entry in annotation.metadata if isinstance(entry, Kinds)]
        yield from models_in(open_unions[0] if open_unions else annotation.annotation)
    elif isinstance(annotation, Kinds):
        yield from annotation.values()
    elif isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    elif get_origin(annotation) is Annotated:
        inner, *metadata = get_args(annotation)
        open_unions = [entry for entry in metadata if isinstance(entry, Kinds)]
        yield from models_in(open_unions[0] if open_unions else inner)
    else:
        for argument in get_args(annotation):
            yield from models_in(argument)
