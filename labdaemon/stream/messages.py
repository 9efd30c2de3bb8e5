"""Commands as they travel: JSON-RPC 2.0 without batches, and how our errors become its codes and back.

A request is one frame of UTF-8 JSON. Unknown members are ignored, so that a newer client can talk to an
older daemon. Numbers that JSON does not have (NaN, infinities, a float beyond double range) are refused.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, ClassVar

from labdaemon.errors import ConfigError, DeviceError, InterlockError, LabdaemonError, LimitError, UsageError
from labdaemon.plain_json import dump_json
from labdaemon.stream.text_limits import bounded_text, is_text, parse_json, surrogate_in

# The first five are those of JSON-RPC 2.0; its range for servers begins at -32000.
PARSE_ERROR = -32700
INVALID_REQUEST = -32600
METHOD_NOT_FOUND = -32601
INVALID_PARAMS = -32602
INTERNAL_ERROR = -32603
BUSY = -32000
FORBIDDEN = -32001
LIMITS = -32002
NOT_FOUND = -32003
WRONG_STATE = -32004
DEVICE = -32005

NAMES = {
    PARSE_ERROR: "parse_error",
    INVALID_REQUEST: "invalid_request",
    METHOD_NOT_FOUND: "method_not_found",
    INVALID_PARAMS: "invalid_params",
    INTERNAL_ERROR: "internal_error",
    BUSY: "busy",
    FORBIDDEN: "forbidden",
    LIMITS: "limits",
    NOT_FOUND: "not_found",
    WRONG_STATE: "wrong_state",
    DEVICE: "device",
}
"""Code -> the word in ``error.data.name``."""

RequestId = str | int | float | None

MAX_ID = 200
"""Characters or digits of a request's id, which every answer mirrors."""


class CommandError(LabdaemonError):
    """A command that cannot be done now, or not by this client."""

    code: ClassVar[int] = INTERNAL_ERROR


class BusyError(CommandError):
    """Something else has to end first."""

    code = BUSY
    retryable = True


class ForbiddenError(CommandError):
    """The client may not."""

    code = FORBIDDEN


class NotFoundError(CommandError):
    """What the command names does not exist."""

    code = NOT_FOUND


class WrongStateError(CommandError):
    """The campaign or the rig is not in a state for it."""

    code = WRONG_STATE


class InvalidParamsError(CommandError):
    """Parameters are missing, of a wrong type or out of range."""

    code = INVALID_PARAMS


class UnknownMethodError(CommandError):
    """There is no such method."""

    code = METHOD_NOT_FOUND


class BadRequestError(Exception):
    """A frame that is no request.

    Attributes
    ----------
    code
        `PARSE_ERROR` or `INVALID_REQUEST`.
    id
        The request's id as far as it could be read, None otherwise.
    """

    def __init__(self, code: int, message: str, request_id: RequestId = None) -> None:
        super().__init__(message)
        self.code: int = code
        self.id: RequestId = request_id


@dataclass(frozen=True, slots=True)
class RpcRequest:
    """A command as it came.

    Attributes
    ----------
    id
        Mirrored in the answer.
    is_notification
        It had no id, so it is done and not answered.
    """

    method: str
    params: dict[str, Any]
    id: RequestId
    is_notification: bool


def parse_request(frame: bytes) -> RpcRequest:
    """Read one frame.

    Raises
    ------
    BadRequestError
        Not JSON, or JSON that is no request.
    """
    try:
        document = parse_json(frame)
    except ValueError as exc:
        raise BadRequestError(PARSE_ERROR, f"not JSON: {bounded_text(exc, 200)}") from None
    if isinstance(document, list):
        raise BadRequestError(INVALID_REQUEST, "batches are not supported; send one request a message")
    if not isinstance(document, dict):
        raise BadRequestError(INVALID_REQUEST, "a request is a JSON object")
    request_id = document.get("id")
    if isinstance(request_id, bool) or not isinstance(request_id, str | int | float | None):
        raise BadRequestError(INVALID_REQUEST, "id is a string, a number or null")
    if request_id is not None and not (len(str(request_id)) <= MAX_ID and is_text(str(request_id))):
        raise BadRequestError(INVALID_REQUEST, f"id is a text or a number of at most {MAX_ID} characters")
    if document.get("jsonrpc") != "2.0":
        raise BadRequestError(INVALID_REQUEST, 'jsonrpc is "2.0"', request_id)
    method, params = document.get("method"), document.get("params", {})
    if not isinstance(method, str):
        raise BadRequestError(INVALID_REQUEST, "method is a string", request_id)
    if not isinstance(params, dict | list):
        raise BadRequestError(INVALID_REQUEST, "params is an object", request_id)
    if isinstance(params, list):
        if params:
            raise BadRequestError(INVALID_PARAMS, "params go by name: send an object", request_id)
        params = {}
    if (where := surrogate_in(params)) is not None:
        raise BadRequestError(
            INVALID_PARAMS, f"{bounded_text(where)} is no text: it has half a surrogate pair", request_id
        )
    return RpcRequest(method, params, request_id, "id" not in document)


def request_bytes(method: str, params: dict[str, Any], request_id: RequestId) -> bytes:
    """A request as a client sends it."""
    document = {"jsonrpc": "2.0", "id": request_id, "method": method, "params": params}
    return json.dumps(document, allow_nan=False, separators=(",", ":")).encode()


@dataclass(frozen=True, slots=True)
class RawJson:
    """A result that is JSON already, so that nothing has to make it on the event loop.

    Attributes
    ----------
    parts
        UTF-8 JSON, in pieces: megabytes are joined once, when they are sent.
    """

    parts: tuple[bytes, ...]

    @property
    def text(self) -> bytes:
        """The whole of it."""
        return b"".join(self.parts)


def result_bytes(result: Any, request_id: RequestId) -> bytes:
    """The answer to a command that was done.

    Raises
    ------
    ValueError, TypeError
        The result is not JSON (NaN among it).
    """
    if isinstance(result, RawJson):
        head = b'{"jsonrpc":"2.0","id":%s,"result":' % json.dumps(request_id).encode()
        return b"".join((head, *result.parts, b"}"))
    return dump_json({"jsonrpc": "2.0", "id": request_id, "result": result}).encode()


def error_bytes(code: int, message: str, request_id: RequestId, **data: Any) -> bytes:
    """The answer to a command that was not done; `data` is sent with the code's name."""
    error = {"code": code, "message": message, "data": {"name": NAMES.get(code, "error"), **data}}
    return dump_json({"jsonrpc": "2.0", "id": request_id, "error": error}).encode()


def code_of(error: LabdaemonError) -> int:
    """The code that a client gets for this error: by who is at fault."""
    match error:
        case CommandError():
            return error.code
        case LimitError():
            return LIMITS
        case ConfigError() | UsageError():
            return INVALID_PARAMS
        case InterlockError():
            return WRONG_STATE
        case DeviceError():
            return DEVICE
        case _:
            return INTERNAL_ERROR
