"""Image marks: what a frame costs to mark and to read."""

import pathlib
import sys

import numpy as np

from table import row

# A picture of a splat model, in which all three find their bits again; in smoother ones some do not.
PICTURE = pathlib.Path(__file__).resolve().parents[2] / "tests/golden/formats/pictures/models_robot.png"
SIDE = 400
# All that RivaGAN takes.
BITS = 32
METHODS = [("rivaGan", "RivaGAN", "f32"), ("dwtDct", "dwtDct", "f64"), ("dwtDctSvd", "dwtDctSvd", "f64")]


def load_rivagan():
    """Sessions as the package makes them, but threads that wait for work must not count as CPU time."""
    import imwatermark
    import onnxruntime
    from imwatermark.rivaGan import RivaWatermark

    options = onnxruntime.SessionOptions()
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    home = pathlib.Path(imwatermark.__file__).parent
    RivaWatermark.encoder, RivaWatermark.decoder = (
        onnxruntime.InferenceSession(home / f"rivagan_{part}.onnx", options, ["CPUExecutionProvider"])
        for part in ["encoder", "decoder"]
    )


def mark_rows():
    """invisible-watermark's three methods on one frame, whose bits must be read back from what was embedded."""
    import cv2
    from imwatermark import WatermarkDecoder, WatermarkEncoder

    load_rivagan()
    picture = cv2.imread(str(PICTURE))
    if picture is None:
        raise RuntimeError(f"{PICTURE} is no picture that OpenCV reads")
    frame = cv2.resize(picture, (SIDE, SIDE), interpolation=cv2.INTER_CUBIC)
    bits = np.random.default_rng(1).integers(0, 2, BITS)
    encoder, decoder = WatermarkEncoder(), WatermarkDecoder("bits", BITS)
    encoder.set_watermark("bits", bits)
    rows = []
    for method, name, precision in METHODS:
        marked = encoder.encode(frame, method)
        wrong = int((np.asarray(decoder.decode(marked, method)) != bits).sum())
        psnr = cv2.PSNR(marked, frame)
        print(f"invisible-watermark {name}: {wrong} of {BITS} bits wrong, {psnr:.1f} dB", file=sys.stderr)
        if wrong:
            raise RuntimeError(f"invisible-watermark's {name} reads {wrong} of {BITS} bits wrong from its own frame")
        who = (f"invisible-watermark {name}", precision, None)
        rows.append(row(f"image mark/embed {SIDE}x{SIDE}", *who, lambda: encoder.encode(frame, method)))
        rows.append(row(f"image mark/decode {SIDE}x{SIDE}", *who, lambda: decoder.decode(marked, method)))
    return rows
