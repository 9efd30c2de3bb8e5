"""Numbers of PTP (ISO 15740) and of Nikon's additions, as far as they are used here."""

from __future__ import annotations

from enum import IntEnum


class ContainerKind(IntEnum):
    """Container types."""

    COMMAND = 1
    DATA = 2
    RESPONSE = 3
    EVENT = 4


class Op(IntEnum):
    """Operations."""

    GET_DEVICE_INFO = 0x1001
    OPEN_SESSION = 0x1002
    CLOSE_SESSION = 0x1003
    GET_STORAGE_IDS = 0x1004
    GET_STORAGE_INFO = 0x1005
    GET_OBJECT_HANDLES = 0x1007
    GET_OBJECT_INFO = 0x1008
    GET_OBJECT = 0x1009
    DELETE_OBJECT = 0x100B
    INITIATE_CAPTURE = 0x100E
    GET_PROP_DESC = 0x1014
    GET_PROP_VALUE = 0x1015
    SET_PROP_VALUE = 0x1016
    GET_PARTIAL_OBJECT = 0x101B
    NIKON_TAKE_OVER = 0x90C2
    NIKON_GET_EVENT = 0x90C7
    NIKON_DEVICE_READY = 0x90C8


class Response(IntEnum):
    """Response codes."""

    OK = 0x2001
    GENERAL_ERROR = 0x2002
    SESSION_NOT_OPEN = 0x2003
    BAD_TRANSACTION = 0x2004
    NOT_SUPPORTED = 0x2005
    INCOMPLETE_TRANSFER = 0x2007
    BAD_STORAGE = 0x2008
    BAD_HANDLE = 0x2009
    PROPERTY_NOT_SUPPORTED = 0x200A
    STORE_FULL = 0x200C
    ACCESS_DENIED = 0x200F
    PARTIAL_DELETION = 0x2012
    BUSY = 0x2019
    BAD_PROPERTY_VALUE = 0x201C
    BAD_PARAMETER = 0x201D
    ALREADY_OPEN = 0x201E
    NIKON_OUT_OF_FOCUS = 0xA002
    NIKON_INVALID_STATUS = 0xA004
    NIKON_BULB_BUSY = 0xA200


class EventCode(IntEnum):
    """Events."""

    OBJECT_ADDED = 0x4002
    OBJECT_REMOVED = 0x4003
    PROP_CHANGED = 0x4006
    STORE_FULL = 0x400A
    STORAGE_CHANGED = 0x400C
    CAPTURE_COMPLETE = 0x400D
    NIKON_ADDED_IN_SDRAM = 0xC101


class Prop(IntEnum):
    """Device properties."""

    BATTERY = 0x5001
    COMPRESSION = 0x5004
    F_NUMBER = 0x5007
    EXPOSURE_MODE = 0x500E
    EXPOSURE_TIME = 0x500D
    ISO = 0x500F
    NIKON_SHUTTER = 0xD100


FORMAT_FOLDER = 0x3001  # of the standard: an association
ALL_STORAGES = 0xFFFFFFFF  # of the standard: every card of the body

MEANINGS: dict[int, str] = {
    Response.GENERAL_ERROR: "general error",
    Response.SESSION_NOT_OPEN: "session not open",
    Response.NOT_SUPPORTED: "operation not supported",
    Response.INCOMPLETE_TRANSFER: "transfer incomplete",
    Response.BAD_HANDLE: "no such object",
    Response.PROPERTY_NOT_SUPPORTED: "property not supported",
    Response.STORE_FULL: "card full: empty it or change it",
    Response.ACCESS_DENIED: "denied: is the body's own menu open, the object protected or the dial in the way?",
    Response.BUSY: "busy",
    Response.BAD_PROPERTY_VALUE: "value not accepted",
    Response.NIKON_OUT_OF_FOCUS: "out of focus: set the lens to manual focus",
    Response.NIKON_INVALID_STATUS: "not possible in the body's present state",
    Response.NIKON_BULB_BUSY: "shutter open on bulb",
}
"""What to tell a person about a response."""
