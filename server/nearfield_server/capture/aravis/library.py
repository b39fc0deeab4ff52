"""A typed binding of libaravis (0.8 and 0.10), and of what it needs of GLib, by ctypes: nothing is compiled, any Python works.

Each C function is declared once, as a method of `Functions` whose annotations say both the Python and the C type; `load` turns them
into ctypes prototypes. A function marked `@_fails` takes a trailing `GError **` in C, which becomes an `AravisError`.

    aravis = load()
    value = aravis.c.arv_device_get_float_feature_value(device, b"ExposureTime")

Objects are addresses (int, never 0); a function that may return NULL is annotated so. Whoever calls a constructor owns a reference and
gives it back with `Aravis.unref`. Source of the declarations: API documentation of Aravis 0.8 and 0.10, GObject, GIO.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable
from typing import Annotated, Any, Final, Protocol, TypeVar, cast, get_type_hints

from nearfield_server.errors import CaptureError

_LIBRARIES: Final = (("libaravis-0.10.so.0", (0, 10)), ("libaravis-0.8.so.0", (0, 8)))
INSTALL_HINT: Final = "install it with: apt-get install --no-install-recommends libaravis-0.8-0"

Object = Annotated[int, ctypes.c_void_p]
MaybeObject = Annotated[int | None, ctypes.c_void_p]
Address = Annotated[int | None, ctypes.c_void_p]
Text = Annotated[bytes, ctypes.c_char_p]
MaybeText = Annotated[bytes | None, ctypes.c_char_p]
Int = Annotated[int, ctypes.c_int]
UInt = Annotated[int, ctypes.c_uint]
UInt16 = Annotated[int, ctypes.c_uint16]
UInt32 = Annotated[int, ctypes.c_uint32]
Int64 = Annotated[int, ctypes.c_int64]
UInt64 = Annotated[int, ctypes.c_uint64]
Size = Annotated[int, ctypes.c_size_t]
Double = Annotated[float, ctypes.c_double]
Bool = Annotated[bool, ctypes.c_int]
Out = Annotated[Any, ctypes.c_void_p]  # ctypes.byref(...) of the caller's variable
Callback = Annotated[Any, ctypes.c_void_p]  # a ctypes function object, which the caller keeps alive, or None

_Function = TypeVar("_Function", bound=Callable[..., Any])

BUFFER_STATUS: Final = {
    -1: "unknown",
    0: "success",
    1: "cleared",
    2: "timeout",
    3: "missing packets",
    4: "wrong packet id",
    5: "size mismatch",
    6: "filling",
    7: "aborted",
}
BUFFER_SUCCESS: Final = 0
BUFFER_ABORTED: Final = 7
ACCESS_READ_ONLY: Final = 0
ACCESS_WRITE_ONLY: Final = 1
ACCESS_READ_WRITE: Final = 2
SOCKET_BUFFER_FIXED: Final = 0
PACKET_SIZE_NEVER: Final = 0  # ArvGvPacketSizeAdjustment: leave the packet size alone
PACKET_SIZE_ON_FAILURE_ONCE: Final = 1  # change it if test packets do not arrive
DEVICE_ERROR_TIMEOUT: Final = 5

ControlLostHandler = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)  # (device, user data)
FillPattern = ctypes.CFUNCTYPE(  # (buffer, user data, exposure time in us, gain, pixel format)
    None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_uint32
)


class AravisError(CaptureError):
    """What a C function reported.

    Attributes:
        function: name of the C function.
        domain: of the GError, "arv-device-error-quark", "g-io-error-quark", ...
        code: of the GError, within its domain.
        reason: the words of the C library, made printable.
    """

    def __init__(self, function: str, domain: str, code: int, reason: str) -> None:
        super().__init__(f"{function}: {reason}")
        self.function, self.domain, self.code, self.reason = function, domain, code, reason

    @property
    def is_timeout(self) -> bool:
        """The device did not answer."""
        return self.domain == "arv-device-error-quark" and self.code == DEVICE_ERROR_TIMEOUT


def printable(text: bytes | str | None, limit: int = 128) -> str:
    """Make what a camera says fit for messages and logs: no control or formatting characters, at most `limit` characters."""
    if text is None:
        return ""
    words = text[: 4 * limit].decode("utf-8", "replace") if isinstance(text, bytes) else text
    clean = "".join(character if character.isprintable() else "?" for character in words[: limit + 1])
    return clean if len(clean) <= limit else clean[: limit - 3] + "..."


class _GErrorStruct(ctypes.Structure):
    _fields_ = (("domain", ctypes.c_uint32), ("code", ctypes.c_int), ("message", ctypes.c_char_p))


class _GValueStruct(ctypes.Structure):
    _fields_ = (("type", ctypes.c_size_t), ("data", ctypes.c_uint64 * 2))


_GTYPE_BOOLEAN, _GTYPE_INT64, _GTYPE_DOUBLE = 5 << 2, 10 << 2, 15 << 2


def _fails(function: _Function) -> _Function:
    """Mark a declaration whose C function takes a trailing GError."""
    function.__dict__["takes_error"] = True
    return function


class Functions(Protocol):
    """The C functions, declared as in the headers, without the trailing GError."""

    # GLib, GObject, GIO
    def g_free(self, memory: Address) -> None: ...  # noqa: D102
    def g_error_free(self, error: Object) -> None: ...  # noqa: D102
    def g_quark_to_string(self, quark: UInt32) -> MaybeText: ...  # noqa: D102
    def g_object_ref(self, instance: Object) -> Object: ...  # noqa: D102
    def g_object_unref(self, instance: Object) -> None: ...  # noqa: D102
    def g_object_get_data(self, instance: Object, key: Text) -> Address: ...  # noqa: D102
    def g_object_set_data(self, instance: Object, key: Text, value: Address) -> None: ...  # noqa: D102
    def g_object_set_property(self, instance: Object, name: Text, value: Out) -> None: ...  # noqa: D102
    def g_value_init(self, value: Out, gtype: Size) -> Address: ...  # noqa: D102
    def g_value_unset(self, value: Out) -> None: ...  # noqa: D102
    def g_value_set_boolean(self, value: Out, number: Bool) -> None: ...  # noqa: D102
    def g_value_set_int64(self, value: Out, number: Int64) -> None: ...  # noqa: D102
    def g_value_set_double(self, value: Out, number: Double) -> None: ...  # noqa: D102
    def g_type_name_from_instance(self, instance: Object) -> Text: ...  # noqa: D102
    def g_type_from_name(self, name: Text) -> Size: ...  # noqa: D102
    def g_type_check_instance_is_a(self, instance: Object, gtype: Size) -> Bool: ...  # noqa: D102
    def g_signal_connect_data(  # noqa: D102
        self,
        instance: Object,
        signal: Text,
        handler: Callback,
        data: Address,
        destroy: Callback,
        flags: Int,
    ) -> Annotated[int, ctypes.c_ulong]: ...
    def g_signal_handler_disconnect(  # noqa: D102
        self, instance: Object, handler: Annotated[int, ctypes.c_ulong]
    ) -> None: ...
    def g_inet_address_new_from_string(self, text: Text) -> MaybeObject: ...  # noqa: D102

    # Versions and interfaces
    def arv_get_major_version(self) -> UInt: ...  # noqa: D102
    def arv_get_minor_version(self) -> UInt: ...  # noqa: D102
    def arv_get_micro_version(self) -> UInt: ...  # noqa: D102
    def arv_uv_interface_get_instance(self) -> Object: ...  # noqa: D102
    def arv_interface_update_device_list(self, interface: Object) -> None: ...  # noqa: D102
    def arv_interface_get_n_devices(self, interface: Object) -> UInt: ...  # noqa: D102
    def arv_interface_get_device_id(self, interface: Object, index: UInt) -> MaybeText: ...  # noqa: D102
    def arv_interface_get_device_vendor(self, interface: Object, index: UInt) -> MaybeText: ...  # noqa: D102
    def arv_interface_get_device_model(self, interface: Object, index: UInt) -> MaybeText: ...  # noqa: D102
    def arv_interface_get_device_serial_nbr(self, interface: Object, index: UInt) -> MaybeText: ...  # noqa: D102
    def arv_interface_get_device_physical_id(self, interface: Object, index: UInt) -> MaybeText: ...  # noqa: D102

    # Devices
    @_fails
    def arv_gv_device_new(self, host: Object, device: Object) -> MaybeObject: ...  # noqa: D102
    @_fails
    def arv_gv_device_leave_control(self, device: Object) -> Bool: ...  # noqa: D102
    def arv_gv_device_is_controller(self, device: Object) -> Bool: ...  # noqa: D102
    @_fails
    def arv_gv_device_get_packet_size(self, device: Object) -> UInt: ...  # noqa: D102
    @_fails
    def arv_gv_device_set_packet_size(self, device: Object, packet_size: Int) -> None: ...  # noqa: D102
    def arv_gv_device_set_packet_size_adjustment(self, device: Object, policy: Int) -> None: ...  # noqa: D102
    @_fails
    def arv_gv_device_auto_packet_size(self, device: Object) -> UInt: ...  # noqa: D102
    @_fails
    def arv_gv_device_get_timestamp_tick_frequency(self, device: Object) -> UInt64: ...  # noqa: D102
    def arv_gv_device_set_stream_options(self, device: Object, options: Int) -> None: ...  # noqa: D102
    @_fails
    def arv_uv_device_new(  # noqa: D102
        self, vendor: MaybeText, product: MaybeText, serial: Text
    ) -> MaybeObject: ...
    @_fails
    def arv_uv_device_new_from_guid(self, guid: Text) -> MaybeObject: ...  # noqa: D102
    @_fails
    def arv_fake_device_new(self, serial: Text) -> MaybeObject: ...  # noqa: D102
    def arv_device_get_genicam_xml(self, device: Object, size: Out) -> Address: ...  # noqa: D102
    def arv_device_get_feature(self, device: Object, feature: Text) -> MaybeObject: ...  # noqa: D102
    def arv_device_get_feature_access_mode(self, device: Object, feature: Text) -> Int: ...  # noqa: D102
    @_fails
    def arv_device_is_feature_available(self, device: Object, feature: Text) -> Bool: ...  # noqa: D102
    @_fails
    def arv_device_execute_command(self, device: Object, feature: Text) -> None: ...  # noqa: D102
    @_fails
    def arv_device_set_boolean_feature_value(self, device: Object, feature: Text, value: Bool) -> None: ...  # noqa: D102
    @_fails
    def arv_device_get_boolean_feature_value(self, device: Object, feature: Text) -> Bool: ...  # noqa: D102
    @_fails
    def arv_device_set_string_feature_value(self, device: Object, feature: Text, value: Text) -> None: ...  # noqa: D102
    @_fails
    def arv_device_get_string_feature_value(self, device: Object, feature: Text) -> MaybeText: ...  # noqa: D102
    @_fails
    def arv_device_set_integer_feature_value(self, device: Object, feature: Text, value: Int64) -> None: ...  # noqa: D102
    @_fails
    def arv_device_get_integer_feature_value(self, device: Object, feature: Text) -> Int64: ...  # noqa: D102
    @_fails
    def arv_device_get_integer_feature_bounds(  # noqa: D102
        self, device: Object, feature: Text, least: Out, greatest: Out
    ) -> None: ...
    @_fails
    def arv_device_get_integer_feature_increment(self, device: Object, feature: Text) -> Int64: ...  # noqa: D102
    @_fails
    def arv_device_set_float_feature_value(self, device: Object, feature: Text, value: Double) -> None: ...  # noqa: D102
    @_fails
    def arv_device_get_float_feature_value(self, device: Object, feature: Text) -> Double: ...  # noqa: D102
    @_fails
    def arv_device_get_float_feature_bounds(  # noqa: D102
        self, device: Object, feature: Text, least: Out, greatest: Out
    ) -> None: ...
    @_fails
    def arv_device_dup_available_enumeration_feature_values_as_strings(  # noqa: D102
        self, device: Object, feature: Text, count: Out
    ) -> Address: ...
    @_fails
    def arv_device_read_register(self, device: Object, address: UInt64, value: Out) -> Bool: ...  # noqa: D102
    @_fails
    def arv_device_write_register(self, device: Object, address: UInt64, value: UInt32) -> Bool: ...  # noqa: D102
    def arv_device_create_chunk_parser(self, device: Object) -> MaybeObject: ...  # noqa: D102
    @_fails
    def arv_chunk_parser_get_integer_value(self, parser: Object, buffer: Object, chunk: Text) -> Int64: ...  # noqa: D102
    @_fails
    def arv_chunk_parser_get_float_value(self, parser: Object, buffer: Object, chunk: Text) -> Double: ...  # noqa: D102

    # Streams
    def arv_stream_push_buffer(self, stream: Object, buffer: Object) -> None: ...  # noqa: D102
    def arv_stream_try_pop_buffer(self, stream: Object) -> MaybeObject: ...  # noqa: D102
    def arv_stream_timeout_pop_buffer(self, stream: Object, timeout_us: UInt64) -> MaybeObject: ...  # noqa: D102
    @_fails
    def arv_stream_start_acquisition(self, stream: Object) -> Bool: ...  # noqa: D102
    @_fails
    def arv_stream_stop_acquisition(self, stream: Object) -> Bool: ...  # noqa: D102
    def arv_stream_get_statistics(  # noqa: D102
        self, stream: Object, completed: Out, failures: Out, underruns: Out
    ) -> None: ...
    def arv_gv_stream_get_statistics(self, stream: Object, resent: Out, missing: Out) -> None: ...  # noqa: D102
    def arv_gv_stream_get_port(self, stream: Object) -> UInt16: ...  # noqa: D102

    # Buffers
    def arv_buffer_new(self, size: Size, preallocated: Address) -> Object: ...  # noqa: D102
    def arv_buffer_get_status(self, buffer: Object) -> Int: ...  # noqa: D102
    def arv_buffer_get_data(self, buffer: Object, size: Out) -> Address: ...  # noqa: D102
    def arv_buffer_get_payload_type(self, buffer: Object) -> Int: ...  # noqa: D102
    def arv_buffer_get_image_pixel_format(self, buffer: Object) -> UInt32: ...  # noqa: D102
    def arv_buffer_get_image_width(self, buffer: Object) -> Int: ...  # noqa: D102
    def arv_buffer_get_image_height(self, buffer: Object) -> Int: ...  # noqa: D102
    def arv_buffer_get_image_padding(self, buffer: Object, right: Out, below: Out) -> None: ...  # noqa: D102
    def arv_buffer_get_image_x(self, buffer: Object) -> Int: ...  # noqa: D102
    def arv_buffer_get_image_y(self, buffer: Object) -> Int: ...  # noqa: D102
    def arv_buffer_get_frame_id(self, buffer: Object) -> UInt64: ...  # noqa: D102
    def arv_buffer_set_frame_id(self, buffer: Object, frame_id: UInt64) -> None: ...  # noqa: D102
    def arv_buffer_get_timestamp(self, buffer: Object) -> UInt64: ...  # noqa: D102
    def arv_buffer_set_timestamp(self, buffer: Object, timestamp_ns: UInt64) -> None: ...  # noqa: D102
    def arv_buffer_get_system_timestamp(self, buffer: Object) -> UInt64: ...  # noqa: D102
    def arv_buffer_has_chunks(self, buffer: Object) -> Bool: ...  # noqa: D102

    # The simulated GigE Vision camera
    def arv_gv_fake_camera_new_full(  # noqa: D102
        self, host: Text, serial: MaybeText, genicam_file: MaybeText
    ) -> MaybeObject: ...
    def arv_gv_fake_camera_is_running(self, camera: Object) -> Bool: ...  # noqa: D102
    def arv_gv_fake_camera_get_fake_camera(self, camera: Object) -> Object: ...  # noqa: D102
    def arv_fake_camera_read_register(self, camera: Object, address: UInt32, value: Out) -> Bool: ...  # noqa: D102
    def arv_fake_camera_write_register(self, camera: Object, address: UInt32, value: UInt32) -> Bool: ...  # noqa: D102
    def arv_fake_camera_read_memory(  # noqa: D102
        self, camera: Object, address: UInt32, size: UInt32, memory: Out
    ) -> Bool: ...
    def arv_fake_camera_write_memory(  # noqa: D102
        self, camera: Object, address: UInt32, size: UInt32, memory: Out
    ) -> Bool: ...
    def arv_fake_camera_get_payload(self, camera: Object) -> Size: ...  # noqa: D102
    def arv_fake_camera_get_acquisition_status(self, camera: Object) -> UInt32: ...  # noqa: D102
    def arv_fake_camera_get_control_channel_privilege(self, camera: Object) -> UInt32: ...  # noqa: D102
    def arv_fake_camera_set_control_channel_privilege(self, camera: Object, privilege: UInt32) -> None: ...  # noqa: D102
    def arv_fake_camera_get_heartbeat_timeout(self, camera: Object) -> UInt32: ...  # noqa: D102
    def arv_fake_camera_set_trigger_frequency(self, camera: Object, frequency: Double) -> None: ...  # noqa: D102
    def arv_fake_camera_is_in_free_running_mode(self, camera: Object) -> Bool: ...  # noqa: D102
    def arv_fake_camera_is_in_software_trigger_mode(self, camera: Object) -> Bool: ...  # noqa: D102


class Aravis:
    """The loaded library.

    Attributes:
        c: the C functions, see `Functions`.
        version: of the library, (major, minor, micro).
    """

    def __init__(self, library: ctypes.CDLL, api: tuple[int, int]) -> None:
        self._library, self._api = library, api
        self.c: Functions = cast(Functions, _Bound(library))
        self.version = (
            self.c.arv_get_major_version(),
            self.c.arv_get_minor_version(),
            self.c.arv_get_micro_version(),
        )

    def is_a(self, instance: int, type_name: str) -> bool:
        """Whether an object is of a GObject class or implements a GObject interface ("ArvGcFloat")."""
        gtype = self.c.g_type_from_name(type_name.encode())
        return gtype != 0 and self.c.g_type_check_instance_is_a(instance, gtype)

    def set_property(self, instance: int, name: str, value: bool | int | float) -> None:
        """Set a property of a GObject; GObject converts the number to the type of the property and clamps nothing."""
        cell = _GValueStruct()
        place = ctypes.byref(cell)
        if isinstance(value, bool):
            self.c.g_value_init(place, _GTYPE_BOOLEAN)
            self.c.g_value_set_boolean(place, value)
        elif isinstance(value, int):
            self.c.g_value_init(place, _GTYPE_INT64)
            self.c.g_value_set_int64(place, value)
        else:
            self.c.g_value_init(place, _GTYPE_DOUBLE)
            self.c.g_value_set_double(place, value)
        self.c.g_object_set_property(instance, name.encode(), place)
        self.c.g_value_unset(place)

    def connect(self, instance: int, signal: str, handler: Any) -> int:
        """Call `handler` (such as a `ControlLostHandler`, kept alive by the caller) at a signal; it runs in whichever thread emits it."""
        return self.c.g_signal_connect_data(instance, signal.encode(), handler, None, None, 0)

    def create_stream(self, device: int) -> int:
        """Open the stream of a device and start its receiving thread.

        Raises:
            AravisError: the device refuses or does not answer.
        """
        arguments = (device, None, None) if self._api < (0, 10) else (device, None, None, None)
        function = self._library.arv_device_create_stream
        function.restype, function.argtypes = ctypes.c_void_p, [ctypes.c_void_p] * (len(arguments) + 1)
        stream = _call_checked(self.c, "arv_device_create_stream", function, arguments)
        if not stream:
            raise AravisError("arv_device_create_stream", "", 0, "returned nothing")
        return int(stream)

    def start_acquisition(self, device: int, stream: int) -> None:
        """Let the device send; raises AravisError if it refuses."""
        if self._api >= (0, 10):
            self.c.arv_stream_start_acquisition(stream)
        self.c.arv_device_execute_command(device, b"AcquisitionStart")

    def stop_acquisition(self, device: int, stream: int) -> None:
        """Let the device stop sending; raises AravisError if it does not answer."""
        self.c.arv_device_execute_command(device, b"AcquisitionStop")
        if self._api >= (0, 10):
            self.c.arv_stream_stop_acquisition(stream)

    def set_fill_pattern(self, fake_camera: int, pattern: Any) -> None:
        """Let a `FillPattern` (kept alive by the caller) draw the pictures of a simulated camera, in the camera's thread."""
        arguments = (
            (fake_camera, pattern, None) if self._api < (0, 10) else (fake_camera, pattern, None, None)
        )
        function = self._library.arv_fake_camera_set_fill_pattern
        function.restype, function.argtypes = None, [ctypes.c_void_p] * len(arguments)
        function(*arguments)

    def unref(self, instance: int | None) -> None:
        """Give back a reference to an object; None is ignored."""
        if instance:
            self.c.g_object_unref(instance)

    def texts(self, function: Callable[[Any], int | None], limit: int = 4096) -> tuple[str, ...]:
        """Texts of a C array that `function(byref(count))` allocates; frees the array (its texts belong to the device)."""
        count = ctypes.c_uint(0)
        array = function(ctypes.byref(count))
        if not array:
            return ()
        try:
            pointers = (ctypes.c_char_p * min(count.value, limit)).from_address(array)
            return tuple(printable(pointer) for pointer in pointers)
        finally:
            self.c.g_free(array)


class _Bound:
    """Gives each declaration of `Functions` its ctypes prototype when it is first used."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._libraries = (library, *(ctypes.CDLL(name) for name in _GLIB_LIBRARIES))

    def __getattr__(self, name: str) -> Callable[..., Any]:
        declaration = getattr(Functions, name)
        function = self._find(name)
        hints = get_type_hints(declaration, include_extras=True)
        result = hints.pop("return")
        takes_error = "takes_error" in declaration.__dict__
        function.argtypes = [_c_type(hint) for hint in hints.values()]
        function.restype = None if result is type(None) else _c_type(result)
        bound: Callable[..., Any] = function
        if takes_error:
            function.argtypes = [*function.argtypes, ctypes.c_void_p]
            bound = functools.partial(_call_with_error, cast(Functions, self), name, function)
        if result == Bool:
            bound = _as_bool(bound)
        setattr(self, name, bound)
        return bound

    def _find(self, name: str) -> Any:
        for library in self._libraries:
            try:
                return library[name]  # a function object of its own: prototypes set elsewhere do not matter
            except AttributeError:
                continue
        raise CaptureError(f"libaravis has no function {name}; {INSTALL_HINT}")


_GLIB_LIBRARIES: Final = ("libgobject-2.0.so.0", "libgio-2.0.so.0", "libglib-2.0.so.0")


def _c_type(hint: Any) -> Any:
    return hint.__metadata__[0]


def _as_bool(function: Callable[..., Any]) -> Callable[..., bool]:
    return lambda *arguments: bool(function(*arguments))


def _call_with_error(c: Functions, name: str, function: Any, *arguments: Any) -> Any:
    return _call_checked(c, name, function, arguments)


def _call_checked(c: Functions, name: str, function: Any, arguments: tuple[Any, ...]) -> Any:
    error = ctypes.c_void_p()
    result = function(*arguments, ctypes.byref(error))
    if error.value is None:
        return result
    found = _GErrorStruct.from_address(error.value)
    domain = printable(c.g_quark_to_string(found.domain))
    code, reason = found.code, printable(found.message, 300)
    c.g_error_free(error.value)
    raise AravisError(name, domain, code, reason)


@functools.cache
def load() -> Aravis:
    """Load libaravis, 0.10 or else 0.8.

    Raises:
        CaptureError: neither is installed, or one of them is damaged.
    """
    reasons = []
    for name, api in _LIBRARIES:
        try:
            return Aravis(ctypes.CDLL(name), api)
        except OSError as error:
            reasons.append(str(error))
    raise CaptureError(
        f"libaravis is needed for GigE Vision and USB3 Vision cameras; {INSTALL_HINT} ({'; '.join(reasons)})"
    )
