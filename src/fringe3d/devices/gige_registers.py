"""The memory of a simulated GigE Vision camera, and the XML that describes it."""

from __future__ import annotations

import ipaddress
import struct

XML_ADDRESS = 0x100000
URL_ADDRESS, URL_SIZE = 0x200, 512
CCP, STREAM_PORT, PACKET_SIZE, STREAM_ADDRESS = 0xA00, 0xD00, 0xD04, 0xD18
LATCH, LATCHED_HIGH, LATCHED_LOW = 0x944, 0x948, 0x94C
TICKS_PER_S = 1_000_000_000

WIDTH, HEIGHT, PIXEL_FORMAT, PAYLOAD_SIZE = 0x20000, 0x20004, 0x20008, 0x2000C
ACQUISITION_MODE, START, STOP = 0x20010, 0x20014, 0x20018
TRIGGER_SELECTOR, TRIGGER_MODE, TRIGGER_SOURCE, TRIGGER = 0x2001C, 0x20020, 0x20024, 0x20028
LOCKED, EXPOSURE_US, GAIN_DB = 0x2002C, 0x20030, 0x20038

MONO8, MONO16 = 0x01080001, 0x01100007
"""Codes of the pixel format naming convention."""

MAKER, MODEL = "fringe3d", "simulated"
_LARGEST = 0x20100
PACKET_BYTES = 1500


class Registers:
    """The bootstrap registers of the standard, and those of the camera's features.

    Parameters
    ----------
    ip : str; address of the camera
    serial : str
    shape : (n_rows, n_cols)
    bytes_per_pixel : 1 or 2
    """

    def __init__(
        self, ip: str, serial: str, shape: tuple[int, int], bytes_per_pixel: int, /
    ) -> None:
        self._memory = bytearray(_LARGEST)
        self.xml = _xml(serial, shape, bytes_per_pixel).encode()
        number = int(ipaddress.ip_address(ip))
        for address, value in {
            0x0: 0x00020000, 0x4: 0x80000001, 0x8: 0x0000F3D0, 0xC: number, 0x10: 4, 0x14: 4,
            0x24: number, 0x34: 0xFF000000, 0x600: 1, 0x904: 1, 0x934: 0x00000007, 0x938: 3000,
            0x93C: 0, 0x940: TICKS_PER_S, PACKET_SIZE: PACKET_BYTES,
            WIDTH: shape[1], HEIGHT: shape[0], PIXEL_FORMAT: (MONO8, MONO16)[bytes_per_pixel - 1],
            PAYLOAD_SIZE: shape[0] * shape[1] * bytes_per_pixel,
        }.items():  # fmt: skip
            self.set(address, value)
        for address, text in ((0x48, MAKER), (0x68, MODEL), (0x88, "1"), (0xD8, serial)):
            self.write(address, text.encode())
        url = f"Local:camera.xml;{XML_ADDRESS:X};{len(self.xml):X}"
        self.write(URL_ADDRESS, url.encode())
        self.write(EXPOSURE_US, struct.pack(">d", 10_000.0))

    def get(self, address: int, /) -> int:
        """Return a register of four bytes."""
        return int.from_bytes(self.read(address, 4), "big")

    def set(self, address: int, value: int, /) -> None:
        """Set a register of four bytes."""
        self.write(address, value.to_bytes(4, "big"))

    def get_float(self, address: int, /) -> float:
        """Return a number of eight bytes."""
        return float(struct.unpack(">d", self.read(address, 8))[0])

    def read(self, address: int, length: int, /) -> bytes:
        """Return bytes of the memory; the XML has its own place."""
        if address >= XML_ADDRESS:
            part = self.xml[address - XML_ADDRESS :][:length]
            return part.ljust(length, b"\0")
        return bytes(self._memory[address : address + length]).ljust(length, b"\0")

    def write(self, address: int, data: bytes, /) -> None:
        """Write bytes; what lies outside of the memory is left."""
        if address + len(data) <= _LARGEST:
            self._memory[address : address + len(data)] = data

    def discovery(self) -> bytes:
        """Return what answers a search for devices: the first registers."""
        head = bytearray(self.read(0, 0xF8))
        head[0x8:0xA] = b"\0\0"
        return bytes(head)


def _int_reg(name: str, address: int, access: str = "RW") -> str:
    return (
        f'<IntReg Name="{name}Reg"><Address>0x{address:x}</Address><Length>4</Length>'
        f"<AccessMode>{access}</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign>"
        "<Endianess>BigEndian</Endianess></IntReg>"
    )


def _integer(name: str, address: int, access: str = "RO") -> str:
    return f'<Integer Name="{name}"><pValue>{name}Reg</pValue></Integer>' + _int_reg(
        name, address, access
    )


def _choice(name: str, address: int, entries: dict[str, int]) -> str:
    listed = "".join(
        f'<EnumEntry Name="{key}"><Value>{value}</Value></EnumEntry>'
        for key, value in entries.items()
    )
    return (
        f'<Enumeration Name="{name}">{listed}<pValue>{name}Reg</pValue></Enumeration>'
        + _int_reg(name, address)
    )


def _command(name: str, address: int, value: int = 1) -> str:
    return (
        f'<Command Name="{name}"><pValue>{name}Reg</pValue><CommandValue>{value}</CommandValue>'
        "</Command>" + _int_reg(name, address, "WO")
    )


def _float(name: str, address: int, low: float, high: float, unit: str) -> str:
    return (
        f'<Float Name="{name}"><pValue>{name}Reg</pValue><Min>{low}</Min><Max>{high}</Max>'
        f'<Unit>{unit}</Unit></Float><FloatReg Name="{name}Reg"><Address>0x{address:x}</Address>'
        "<Length>8</Length><AccessMode>RW</AccessMode><pPort>Device</pPort>"
        "<Endianess>BigEndian</Endianess></FloatReg>"
    )


def _text(name: str, address: int, length: int) -> str:
    return (
        f'<StringReg Name="{name}"><Address>0x{address:x}</Address><Length>{length}</Length>'
        "<AccessMode>RO</AccessMode><pPort>Device</pPort></StringReg>"
    )


def _xml(serial: str, shape: tuple[int, int], bytes_per_pixel: int) -> str:
    """Return the camera's features in GenICam's words."""
    formats = {"Mono8": MONO8} if bytes_per_pixel == 1 else {"Mono16": MONO16}
    features = {
        "DeviceVendorName": _text("DeviceVendorName", 0x48, 32),
        "DeviceModelName": _text("DeviceModelName", 0x68, 32),
        "DeviceSerialNumber": _text("DeviceSerialNumber", 0xD8, 16),
        "Width": _integer("Width", WIDTH),
        "Height": _integer("Height", HEIGHT),
        "PixelFormat": _choice("PixelFormat", PIXEL_FORMAT, formats),
        "PayloadSize": _integer("PayloadSize", PAYLOAD_SIZE),
        "AcquisitionMode": _choice("AcquisitionMode", ACQUISITION_MODE, {"Continuous": 0}),
        "AcquisitionStart": _command("AcquisitionStart", START),
        "AcquisitionStop": _command("AcquisitionStop", STOP),
        "TriggerSelector": _choice("TriggerSelector", TRIGGER_SELECTOR, {"FrameStart": 0}),
        "TriggerMode": _choice("TriggerMode", TRIGGER_MODE, {"Off": 0, "On": 1}),
        "TriggerSource": _choice("TriggerSource", TRIGGER_SOURCE, {"Software": 0, "Line1": 1}),
        "TriggerSoftware": _command("TriggerSoftware", TRIGGER),
        "ExposureTime": _float("ExposureTime", EXPOSURE_US, 10, 10_000_000, "us"),
        "Gain": _float("Gain", GAIN_DB, 0, 24, "dB"),
        "TLParamsLocked": _integer("TLParamsLocked", LOCKED, "RW"),
        "GevSCPSPacketSize": _integer("GevSCPSPacketSize", PACKET_SIZE, "RW"),
        "GevTimestampTickFrequency": _integer("GevTimestampTickFrequency", 0x940),
        "GevTimestampControlLatch": _command("GevTimestampControlLatch", LATCH, 2),
        "GevTimestampValue": '<Integer Name="GevTimestampValue"><pValue>GevTimestampValueReg'
        f'</pValue></Integer><IntReg Name="GevTimestampValueReg"><Address>0x{LATCHED_HIGH:x}'
        "</Address><Length>8</Length><AccessMode>RO</AccessMode><pPort>Device</pPort>"
        "<Cachable>NoCache</Cachable><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess>"
        "</IntReg>",
    }
    listed = "".join(f"<pFeature>{name}</pFeature>" for name in features)
    return (
        '<?xml version="1.0" encoding="UTF-8"?><RegisterDescription '
        'xmlns="http://www.genicam.org/GenApi/Version_1_1" '
        f'ModelName="{MODEL}" VendorName="{MAKER}" ToolTip="{serial}, {shape[1]} x {shape[0]}" '
        'StandardNameSpace="GEV" SchemaMajorVersion="1" SchemaMinorVersion="1" '
        'SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" SubMinorVersion="0" '
        'ProductGuid="00000000-0000-0000-0000-0000000f3d00" '
        'VersionGuid="00000000-0000-0000-0000-0000000f3d01">'
        f'<Category Name="Root">{listed}</Category>{"".join(features.values())}'
        '<Port Name="Device"/></RegisterDescription>'
    )
