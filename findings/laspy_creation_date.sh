#!/bin/sh
# laspy 2.7.0 writes today's date into a LAS file whose header has creation_date = None, although it
# reads a file without a date (day and year 0) as None: a copy of such a file gets a date, and equal
# points give other bytes on another day. Exits 0 while that is so, 1 if not.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv here
here/bin/pip install --quiet laspy==2.7.0
cat > look.py <<'EOF'
import io
import sys

import laspy

header = laspy.LasHeader(point_format=2, version="1.2")
header.creation_date = None
buffer = io.BytesIO()
laspy.LasData(header).write(buffer)
content = bytearray(buffer.getvalue())
day, year = int.from_bytes(content[90:92], "little"), int.from_bytes(content[92:94], "little")
content[90:94] = bytes(4)
again = laspy.read(io.BytesIO(bytes(content))).header.creation_date
print(f"creation_date = None is written as day {day} of {year}; day 0 of 0 is read as {again}")
sys.exit(0 if year and again is None else 1)
EOF
here/bin/python look.py
