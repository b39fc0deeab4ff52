"""The binding of libaravis: declarations exist in the library, errors become words, texts become printable."""

import ctypes

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nearfield_server.capture.aravis import library
from nearfield_server.capture.aravis.library import AravisError, Functions, load, printable
from nearfield_server.errors import CaptureError


def test_every_declared_function_exists() -> None:
    aravis = load()
    only_newer = {"arv_stream_start_acquisition", "arv_stream_stop_acquisition"}
    declared = [name for name in vars(Functions) if name.startswith(("arv_", "g_"))]
    assert len(declared) > 80
    for name in declared:
        if name not in only_newer or aravis.version >= (0, 9):
            assert callable(getattr(aravis.c, name))


def test_arguments_and_results_have_their_c_types() -> None:
    c = load().c
    assert c.arv_get_major_version() == 0
    with pytest.raises(ctypes.ArgumentError):
        c.g_inet_address_new_from_string("not bytes")  # type: ignore[arg-type]
    assert c.g_inet_address_new_from_string(b"no address") is None


def test_a_reported_error_becomes_words() -> None:
    with pytest.raises(AravisError, match=r"arv_uv_device_new_from_guid: .*not found") as caught:
        load().c.arv_uv_device_new_from_guid(b"no such camera")
    assert caught.value.domain == "arv-device-error-quark"
    assert not caught.value.is_timeout


def test_classes_and_properties() -> None:
    aravis = load()
    address = aravis.c.g_inet_address_new_from_string(b"127.0.0.1")
    assert address is not None
    assert aravis.is_a(address, "GInetAddress")
    assert not aravis.is_a(address, "GSocket")
    assert not aravis.is_a(address, "NoSuchType")
    aravis.unref(address)
    aravis.unref(None)


def test_a_missing_library_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(library, "_LIBRARIES", (("libnothing.so.7", (0, 8)),))
    with pytest.raises(CaptureError, match=r"libaravis is needed.*apt-get install.*libnothing\.so\.7"):
        load.__wrapped__()


@given(st.text() | st.binary() | st.none(), st.integers(3, 40))
def test_printable_is_short_and_without_control_characters(text: str | bytes | None, limit: int) -> None:
    clean = printable(text, limit)
    assert len(clean) <= limit
    assert clean.isprintable()


def test_printable_keeps_plain_words() -> None:
    assert printable(b"Sensor Ltd. \xc3\xa4") == "Sensor Ltd. ä"
    assert printable("a\x1b[31mb\u202ec") == "a?[31mb?c"
    assert printable(b"x" * 1000, 10) == "xxxxxxx..."
