"""Noise and damaged frames through the decoder: false frames, lost frames, memory, throughput.

.venv/bin/python benchmarks/link_decoder.py --megabytes 100
"""

from __future__ import annotations

import argparse
import random
import time
from collections.abc import Iterator

from tricycle_bridge.protocol.framing import Frame, FrameDecoder, encode
from tricycle_bridge.protocol.messages import Board, Message, SteerState

SESSION = 7


def _state(rng: random.Random) -> SteerState:
    t, angle, rate = rng.getrandbits(32), rng.randint(-7854, 7854), rng.randint(-3000, 3000)
    return SteerState(t, 2, 1, 0, angle, angle, rate, 1500, 512, 12000, rng.getrandbits(8), 1)


def _damaged(rng: random.Random, body: bytes) -> bytes:
    """One way a line damages a frame: bits flipped, cut, a piece doubled or lost."""
    data = bytearray(body)
    at, length = rng.randrange(len(data)), rng.randint(1, 8)
    match rng.randrange(4):
        case 0:
            for _ in range(rng.choice((1, 1, 2, 3))):
                data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        case 1:
            del data[at:]
        case 2:
            data[at:at] = data[at : at + length]
        case _:
            del data[at : at + length]
    return bytes(data)


def traffic(rng: random.Random, size: int) -> Iterator[tuple[bytes, list[Message]]]:
    """Chunks of about 64 kB, a third each noise, damaged frames, good frames; and the good ones."""
    sent = 0
    while sent < size:
        pieces: list[bytes] = []
        good: list[Message] = []
        for _ in range(650):
            message = _state(rng)
            frame = encode(message, board=Board.STEER, seq=rng.getrandbits(8), session=SESSION)
            pieces += [rng.randbytes(len(frame)), b"\0"]
            if (damaged := _damaged(rng, frame[:-1])) != frame[:-1]:
                pieces += [damaged, b"\0"]
            pieces += [frame]
            good.append(message)
        chunk = b"".join(pieces)
        sent += len(chunk)
        yield chunk, good


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--megabytes", type=float, default=100.0)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    rng = random.Random(args.seed)
    decoder = FrameDecoder(Board.STEER, host=True)
    decoder.session = SESSION
    false = lost = total = 0
    seconds = 0.0
    held = 0  # bytes
    for chunk, good in traffic(rng, round(args.megabytes * 1e6)):
        start = time.perf_counter()
        frames: list[Frame] = []
        for at in range(0, len(chunk), 4096):  # as read from a port
            frames += decoder.feed(chunk[at : at + 4096])
            held = max(held, decoder.pending)
        seconds += time.perf_counter() - start
        total += len(chunk)
        decoded = [frame.message for frame in frames]
        if decoded != good:
            remaining = list(decoded)
            for message in good:
                if message in remaining:
                    remaining.remove(message)
                else:
                    lost += 1
            false += len(remaining)
    counters = decoder.counters
    print(f"{total / 1e6:.0f} MB of noise, damaged and good frames (seed {args.seed})")
    print(f"false frames         {false}")
    print(f"good frames          {counters.ok + lost}, lost {lost}")
    print(f"rejected segments    {counters.rejected} ({counters})")
    print(f"bytes held at most   {held}")
    print(f"throughput           {total / seconds / 1e6:.1f} MB/s, a line brings 0.0115 MB/s")
    return 0 if false == lost == 0 else 1


if __name__ == "__main__":
    raise SystemExit(main())
