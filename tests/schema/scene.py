"""Images for the tests of this folder, without a library."""
import random
import struct
import zlib


def png(path, rows, bits):
    """A grey PNG; rows of numbers."""
    def chunk(name, data):
        return struct.pack('>I', len(data)) + name + data + struct.pack('>I', zlib.crc32(name + data))
    code = '>%d' + ('B' if bits == 8 else 'H')
    pixels = b''.join(b'\0' + struct.pack(code % len(row), *row) for row in rows)
    header = struct.pack('>IIBBBBB', len(rows[0]), len(rows), bits, 0, 0, 0, 0)
    chunks = chunk(b'IHDR', header) + chunk(b'IDAT', zlib.compress(pixels)) + chunk(b'IEND', b'')
    path.write_bytes(b'\x89PNG\r\n\x1a\n' + chunks)


def texture(width, height):
    """Noise of a few pixels' size, 0 to 255."""
    draw = random.Random(3)
    coarse = [[draw.uniform(0, 255) for _ in range(width // 4 + 2)] for _ in range(height // 4 + 2)]

    def at(u, v):
        i, j, a, b = u // 4, v // 4, u % 4 / 4, v % 4 / 4
        top = (1 - a) * coarse[j][i] + a * coarse[j][i + 1]
        return round((1 - b) * top + b * ((1 - a) * coarse[j + 1][i] + a * coarse[j + 1][i + 1]))
    return [[at(u, v) for u in range(width)] for v in range(height)]
