import pytest

from scan3d_twin.core.errors import LinkError
from scan3d_twin.devices.registry import Devices
from scan3d_twin.real.ports import Port, choose_lidar_port, choose_ports, usb_ports

BASE = Port("/dev/serial/by-id/usb-FTDI_FT231X", "0403:6015", "FT231X USB UART")
LIDAR = Port("/dev/serial/by-id/usb-Hokuyo", "15d1:0000", "URG-Series USB Driver")
OTHER = Port("/dev/ttyUSB3", "1a86:7523", "USB Serial")
MODEM = Port("/dev/ttyACM4", "1199:9071", "MC7455")


@pytest.fixture
def machine(tmp_path):
    """A /sys and a /dev with two USB ports, one of them with a lasting name, and a built-in one."""
    for number, (tty, vendor, product) in enumerate(
        [("ttyUSB0", "0403", "6015"), ("ttyACM0", "15d1", "0000")]
    ):
        usb = tmp_path / f"sys/devices/usb1/1-{number}"
        port = usb / f"1-{number}:1.0/{tty}"
        port.mkdir(parents=True)
        for name, text in (("idVendor", vendor), ("idProduct", product), ("product", tty)):
            (usb / name).write_text(text + "\n")
        (tmp_path / "sys/class/tty" / tty).mkdir(parents=True)
        (tmp_path / "sys/class/tty" / tty / "device").symlink_to(port)
        (tmp_path / "dev").mkdir(exist_ok=True)
        (tmp_path / "dev" / tty).touch()
    (tmp_path / "sys/class/tty/ttyS0").mkdir()
    (tmp_path / "sys/class/tty/ttyAMA0").mkdir()
    (tmp_path / "dev/serial/by-id").mkdir(parents=True)
    (tmp_path / "dev/serial/by-id/usb-Hokuyo").symlink_to("../../ttyACM0")
    return tmp_path


def test_usb_ports_have_lasting_names_where_there_are_some(machine):
    assert usb_ports(machine) == [
        Port(str(machine / "dev/serial/by-id/usb-Hokuyo"), "15d1:0000", "ttyACM0"),
        Port(str(machine / "dev/ttyUSB0"), "0403:6015", "ttyUSB0"),
    ]


def test_no_usb_at_all(tmp_path):
    assert usb_ports(tmp_path) == []


def test_both_are_found_by_their_makers():
    assert choose_ports(None, None, ports=[MODEM, LIDAR, BASE]) == (BASE.path, LIDAR.path)


def test_a_given_port_is_taken_as_it_is_and_not_given_twice():
    assert choose_ports("/dev/pts/1", "/dev/pts/2", ports=[]) == ("/dev/pts/1", "/dev/pts/2")
    assert choose_ports(None, OTHER.path, ports=[OTHER, BASE]) == (BASE.path, OTHER.path)


def test_nothing_found_says_what_to_do():
    with pytest.raises(LinkError, match=r"no base found .* --port"):
        choose_ports(None, "x", ports=[LIDAR, MODEM])
    with pytest.raises(LinkError, match=r"no lidar found on USB \(Hokuyo\).* --lidar-port"):
        choose_ports("x", None, ports=[BASE])


def test_several_are_listed():
    with pytest.raises(LinkError, match=r"2 ports may be the base: .*FT231X.*ttyUSB3.* --port"):
        choose_ports(None, "x", ports=[BASE, OTHER])


def test_the_other_ones_port_is_left_out_under_any_of_its_names(machine):
    """Of two names of the base's port one is given, and the other is that found on USB."""
    usb = machine / "sys/devices/usb1/1-1/1-1:1.0/ttyACM0"
    (usb.parents[1] / "idVendor").write_text("10c4\n")
    (usb.parents[1] / "idProduct").write_text("ea60\n")
    ports = usb_ports(machine)
    (adapter,) = (port for port in ports if port.usb_id == "10c4:ea60")
    plain = str(machine / "dev/ttyACM0")
    assert adapter.path != plain
    with pytest.raises(LinkError, match="no lidar found"):
        choose_lidar_port(plain, None, ports)
    with pytest.raises(LinkError, match="no lidar found"):
        choose_ports(plain, None, Devices(lidar="rplidar_c1"), ports)
    base, _ = choose_ports(None, plain, Devices(lidar="rplidar_c1"), ports)
    assert base == str(machine / "dev/ttyUSB0")


ADAPTER = Port("/dev/ttyUSB5", "10c4:ea60", "CP2102 USB to UART Bridge Controller")


def test_a_lidar_of_any_kind_is_looked_for_where_no_base_can_be():
    assert choose_lidar_port(None, None, [MODEM, LIDAR, BASE]) == LIDAR.path
    assert choose_lidar_port(None, "/dev/pts/1", []) == "/dev/pts/1"
    # Adapters like that are sold with lidars, but bases have them too
    with pytest.raises(LinkError, match="no lidar found"):
        choose_lidar_port(None, None, [ADAPTER, MODEM])
    assert choose_lidar_port(BASE.path, None, [ADAPTER, BASE]) == ADAPTER.path
    with pytest.raises(LinkError, match="both base and lidar"):
        choose_lidar_port("/dev/ttyUSB5", "/dev/../dev/ttyUSB5")
