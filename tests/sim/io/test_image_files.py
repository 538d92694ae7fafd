"""Image files and archives: size before pixels, whole files only, order by number."""

import struct
import zipfile
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from dslab.scenarios.errors import InputError, InputNotice
from dslab.sim.io.image_header import header_size, is_whole
from dslab.sim.io.images import DepthFolder, GrayFolder, GrayZip, by_number, image_shape, numbered_images

SHAPE = (48, 64)
IMAGE = np.random.default_rng(0).integers(0, 256, SHAPE, dtype=np.uint8)


def encoded(suffix: str, image: np.ndarray = IMAGE) -> bytes:
    return cv2.imencode(suffix, image)[1].tobytes()


def png_of_size(width: int, height: int) -> bytes:
    """A PNG file of some pixels whose header states others."""
    data = bytearray(encoded(".png"))
    data[16:24] = struct.pack(">II", width, height)
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    return bytes(data)


@pytest.fixture
def undecoded(monkeypatch):
    """No image is decoded."""
    monkeypatch.setattr(cv2, "imdecode", lambda data, mode: pytest.fail("pixels are decoded"))


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".pgm", ".tif", ".webp"])
@pytest.mark.parametrize("channels", [1, 3])
def test_the_header_states_the_size(suffix, channels):
    image = IMAGE if channels == 1 else cv2.cvtColor(IMAGE, cv2.COLOR_GRAY2BGR)
    data = encoded(".ppm" if (suffix, channels) == (".pgm", 3) else suffix, image)
    assert header_size(data) == SHAPE[::-1] and is_whole(data)


@pytest.mark.parametrize("quality", [50, 101])
def test_both_codings_of_webp_state_the_size(quality):
    data = cv2.imencode(".webp", IMAGE, [cv2.IMWRITE_WEBP_QUALITY, quality])[1].tobytes()
    assert header_size(data) == SHAPE[::-1] and is_whole(data) and not is_whole(data[:-9])
    extended = b"RIFF\0\0\0\0WEBPVP8X" + struct.pack("<I", 10) + b"\0" * 4 + b"\x3f\0\0\x2f\0\0"
    assert header_size(extended) == SHAPE[::-1]


def test_images_of_ten_or_twelve_bits_keep_their_light(tmp_path):
    """Stored as 16-bit PNG, or as PGM whose header says what is white."""
    for bits in (10, 12):
        counts = IMAGE.astype(np.uint16) << (bits - 8)
        path = tmp_path / f"{bits}.png"
        path.write_bytes(encoded(".png", counts))
        with pytest.warns(InputNotice, match=f"hold {bits} bits"):
            found = GrayFolder([path], SHAPE)[0]
        assert np.abs(found.astype(int) - IMAGE).max() <= 1
        path = tmp_path / f"{bits}.pgm"
        path.write_bytes(b"P5 64 48 %d\n" % (2**bits - 1) + counts.astype(">u2").tobytes())
        assert np.abs(GrayFolder([path], SHAPE)[0].astype(int) - IMAGE).max() <= 1
    (tmp_path / "few.pgm").write_bytes(b"P5 64 48 15\n" + (IMAGE >> 4).tobytes())
    assert np.abs(GrayFolder([tmp_path / "few.pgm"], SHAPE)[0].astype(int) - (IMAGE >> 4) * 17).max() == 0


def test_thermal_counts_are_spread_alike_in_all_images(tmp_path, recwarn):
    paths = [tmp_path / f"{n}.png" for n in range(3)]
    for n, path in enumerate(paths):
        path.write_bytes(encoded(".png", (29000 + 4 * IMAGE.astype(int) + 100 * n).astype(np.uint16)))
    frames = GrayFolder(paths, SHAPE)
    assert "counts 29" in str(recwarn.pop(InputNotice).message)
    assert frames[0].std() > 50 and 15 < (frames[1].astype(float) - frames[0]).mean() < 25
    paths[0].write_bytes(encoded(".png", IMAGE.astype(np.uint16) << 8))
    assert np.abs(GrayFolder(paths[:1], SHAPE)[0].astype(int) - IMAGE).max() <= 1 and not recwarn.list


def test_a_header_with_comments_or_padding_states_the_size():
    assert header_size(b"P5\n# by a camera\n# 3 4\n64 # wide\n 48\n255\n" + IMAGE.tobytes()) == (64, 48)
    data = encoded(".jpg")
    comment = b"\xff\xfe" + struct.pack(">H", 4) + b"\xff\xc0"
    assert header_size(data[:2] + comment + b"\xff\xff" + data[2:]) == (64, 48)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".pgm"])
def test_a_file_cut_short_is_refused(tmp_path, suffix):
    data, path = encoded(suffix), tmp_path / f"0{suffix}"
    for end in [*range(0, 60, 7), len(data) // 2, len(data) - 1]:
        path.write_bytes(data[:end])
        with pytest.raises(InputError, match=r"no readable image|cut short"):
            GrayFolder([path], SHAPE)[0]


@pytest.mark.parametrize("at", [20, 40, 100, -20, -6])
def test_a_flipped_bit_of_a_png_file_is_found(tmp_path, at):
    data = bytearray(encoded(".png"))
    data[at] ^= 4
    (tmp_path / "0.png").write_bytes(data)
    with pytest.raises(InputError, match="damaged"):
        GrayFolder([tmp_path / "0.png"], SHAPE)[0]


def test_an_image_of_another_size_is_refused_before_it_is_decoded(tmp_path, undecoded):
    path = tmp_path / "0.png"
    for width, height in ((48, 64), (30000, 30000)):
        path.write_bytes(png_of_size(width, height))
        for of in (GrayFolder, DepthFolder):
            with pytest.raises(InputError, match=rf"is {width}x{height} pixels, camera\.yaml says 64x48"):
                of([path], SHAPE)[0]
    with pytest.raises(InputError, match=r"0\.png: width: the SLAM takes no image of 30000 pixels"):
        image_shape(path)
    path.write_bytes(png_of_size(16000, 16000))
    with pytest.raises(InputError, match="16000x16000 is more than 34 million pixels"):
        image_shape(path)


def test_an_image_turned_by_its_note_is_as_stored_unless_the_calibration_is_of_it_turned(tmp_path):
    data = encoded(".jpg")
    exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    (tmp_path / "0.jpg").write_bytes(
        data[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + data[2:]
    )
    assert GrayFolder([tmp_path / "0.jpg"], SHAPE[::-1])[0].shape == SHAPE[::-1]
    with pytest.warns(InputNotice, match="EXIF note turns it: images count as stored"):
        stored = GrayFolder([tmp_path / "0.jpg"], SHAPE)[0]
    assert np.array_equal(stored, cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE))
    with pytest.raises(InputError, match=r"is 64x48 pixels, camera\.yaml says 50x48"):
        GrayFolder([tmp_path / "0.jpg"], (48, 50))


# -- order ---------------------------------------------------------------------------------------------------


def test_images_are_ordered_by_number(tmp_path):
    for number in range(12):
        (tmp_path / f"{number}.png").write_bytes(b"")
    (tmp_path / "notes.txt").write_text("")
    assert [path.stem for path in numbered_images(tmp_path, (".png",))] == [str(n) for n in range(12)]
    assert by_number(["a/007.png", "b/06.png"], "x") == ["b/06.png", "a/007.png"]
    assert by_number([], "x") == []


@pytest.mark.parametrize(
    ("names", "problem"),
    [
        (["0.png", "1.png", "01.png"], "x: 1.png: number 1 occurs twice"),
        (["0.png", "2.png"], "x: 2.png: image 1 is missing"),
        (["0.png", "left.png"], "x: left.png: 'left' is no number"),
        (["0.png", "1.5.png"], "'1.5' is no number"),
        (["-1.png", "0.png"], "'-1' is no number"),
        (["٣.png"], "is no number"),
        (["9" * 401 + ".png"], "is no number"),
    ],
)
def test_an_order_that_is_not_certain_is_refused(names, problem):
    with pytest.raises(InputError) as caught:
        by_number(names, "x")
    assert problem in str(caught.value)


# -- archives ------------------------------------------------------------------------------------------------


def archive_of(place: Path, names: list[str], packing: int = zipfile.ZIP_STORED) -> Path:
    with zipfile.ZipFile(place / "images.zip", "w", packing) as archive:
        for name in names:
            archive.writestr(name, encoded(".png"))
    return place / "images.zip"


def patched(path: Path, at: int, size: int, value: int) -> Path:
    """The archive with a field of its last entry in the directory changed."""
    data = bytearray(path.read_bytes())
    entry = data.rfind(b"PK\x01\x02")
    data[entry + at : entry + at + size] = value.to_bytes(size, "little")
    path.write_bytes(data)
    return path


def opened(path: Path) -> GrayZip:
    return GrayZip(path, SHAPE, "camera.txt")


def test_the_images_of_an_archive_are_ordered_by_number(tmp_path):
    images = opened(archive_of(tmp_path, ["images/10.png", "images/9.png", "readme.txt"]))
    assert len(images) == 2 and [entry.filename[7:] for entry in images._entries] == ["9.png", "10.png"]
    np.testing.assert_array_equal(images[1], IMAGE)


@pytest.mark.parametrize(
    ("at", "size", "value", "problem"),
    [
        (8, 2, 0x1, "1.png: is encrypted or packed by an unusual method"),
        (8, 2, 0x41, "1.png: is encrypted"),
        (10, 2, 99, "packed by an unusual method"),
        (10, 2, zipfile.ZIP_LZMA, "packed by an unusual method"),
        (24, 4, 3 * 2**30, "1.png: unpacks to 3221 MB"),
        (6, 2, 255, "is no readable zip archive"),
    ],
)
def test_an_entry_that_should_not_be_unpacked_is_refused_at_once(tmp_path, at, size, value, problem):
    path = patched(archive_of(tmp_path, ["0.png", "1.png"]), at, size, value)
    with pytest.raises(InputError) as caught:
        opened(path)
    assert problem in str(caught.value)


def test_a_damaged_entry_or_archive_is_an_input_error(tmp_path):
    path = patched(archive_of(tmp_path, ["0.png", "1.png"], zipfile.ZIP_DEFLATED), 16, 4, 0)
    with pytest.raises(InputError, match=r"1\.png: cannot be unpacked"):
        opened(path)[1]
    data = path.read_bytes()
    for at in range(0, len(data), 97):
        path.write_bytes(data[:at] + b"\xff\xff\xff\xff" + data[at + 4 :])
        try:
            images = opened(path)
            for index in range(len(images)):
                images[index]
        except InputError:
            pass


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_an_entry_that_occurs_twice_is_refused(tmp_path):
    with pytest.raises(InputError, match="number 1 occurs twice"):
        opened(archive_of(tmp_path, ["0.png", "1.png", "1.png"]))
