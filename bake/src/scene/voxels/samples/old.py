"""Writes old.vdb, version 221 with zip, from none.vdb: OpenVDB itself no longer writes such files."""
import struct
import zlib

source = open("none.vdb", "rb").read()
at = 0
out = bytearray()


def take(n):
    global at
    at += n
    assert at <= len(source)
    return source[at - n : at]


def block():
    n = take(4)
    return n + take(struct.unpack("<I", n)[0])


def metadata():
    all = [(block(), block(), block()) for _ in range(struct.unpack("<I", take(4))[0])]
    kept = [b"".join(m) for m in all if not m[0].endswith(b"file_delayed_load")]
    return struct.pack("<I", len(kept)) + b"".join(kept)


def zipped(data):
    packed = zlib.compress(data)
    if len(packed) < len(data):
        return struct.pack("<q", len(packed)) + packed
    return struct.pack("<q", -len(data)) + data


def node(side, child, origin):
    """Masks and the values of tiles alone; gives where the children are."""
    count = side**3
    masks = take(count // 4)
    assert take(1) == b"\x06"
    values = take(4 * count)
    on = [i for i in range(count) if masks[i // 8] >> i % 8 & 1]
    off = sorted(set(range(count)) - set(on))
    out.extend(masks + zipped(b"".join(values[4 * i : 4 * i + 4] for i in off)))
    return [tuple(o + child * c for o, c in zip(origin, (i // side**2, i // side % side, i % side))) for i in on]


head = take(8 + 4 + 8 + 1)
out += head[:8] + struct.pack("<I", 221) + head[12:] + b"\x01" + take(36) + metadata()
out += take(4) + block() + block() + block()
offsets = len(out)
out += take(24)
grid = len(out)
assert take(4) == b"\0\0\0\0"
out += metadata() + block() + take(15 * 8)
out += take(4 + 4)
counts = take(8)
tiles, children = struct.unpack("<II", counts)
out += counts + take(17 * tiles)
leaves = []
for _ in range(children):
    origin = take(12)
    out += origin
    for upper in node(32, 128, struct.unpack("<iii", origin)):
        for leaf in node(16, 8, upper):
            out += take(64)
            leaves.append(leaf)
blocks = len(out)
for leaf in leaves:
    out += take(64) + struct.pack("<iiib", *leaf, 1)
    assert take(1) == b"\x06"
    out += zipped(take(4 * 512))
assert at == len(source)
out[offsets : offsets + 24] = struct.pack("<QQQ", grid, blocks, len(out))
open("old.vdb", "wb").write(out)
