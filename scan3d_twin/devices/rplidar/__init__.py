"""Slamtec RPLIDAR A1, C1 and S2: their protocol, driver and emulator."""

LIDARS = {"rplidar_a1": "RPLIDAR_A1", "rplidar_c1": "RPLIDAR_C1", "rplidar_s2": "RPLIDAR_S2"}
REFUSED = {
    # Frames of their fast scans: Slamtec's SDK 2.1.0
    r"(rp|sl)lidara3\w*": "its scans come in ultra capsules (0x84), and no source says what they "
    "hold where a depth edge is too high for them; take rplidar_a1, rplidar_c1 or rplidar_s2",
    r"(rp|sl)lidars3\w*": "its scans come in ultra-dense capsules (0x86), of which the maker's "
    "decoder is the only source; take rplidar_a1, rplidar_c1 or rplidar_s2",
    r"(rp|sl)lidar(a2|s1|t1)\w*": "no two sources were found that agree on its scan modes and "
    "errors; take rplidar_a1, rplidar_c1 or rplidar_s2",
}
