"""Records of results, made up from what a test is about."""

from types import NoneType, UnionType
from typing import Any, Literal, get_args, get_origin

import msgspec

from excitant.reports.run import as_saved
from excitant.results import Record, Result


def complete(kind: Any, value: Any = None) -> Any:
    """Plain values of this type: nothing in fields that are left out, and no others."""
    options = get_args(kind)
    match get_origin(kind) or kind:
        case origin if isinstance(origin, type) and issubclass(origin, Record):
            value = value or {}
            fields = msgspec.structs.fields(origin)
            names = {f.encode_name: f.type for f in fields if f.required or f.encode_name in value}
            return {name: complete(names[name], value.get(name)) for name in names}
        case origin if origin is list:
            return [complete(options[0], item) for item in value or []]
        case origin if origin is dict:
            return {key: complete(options[1], item) for key, item in (value or {}).items()}
        case origin if origin is UnionType or str(origin) == "typing.Union":
            others = [option for option in options if option is not NoneType]
            return value if value is None or len(others) > 1 else complete(others[0], value)
    if value is None and kind is not Any:
        return options[0] if get_origin(kind) is Literal else kind()
    return value


def full(**partial: Any) -> dict[str, Any]:
    """A full record as plain values."""
    kind = next(k for k in get_args(Result) if k.__struct_config__.tag == partial["verb"])
    return {"verb": partial["verb"], **complete(kind, as_saved(partial, {})[0])}
