"""Text clouds as other programs write them."""

import numpy as np
import pytest

from tests.kit import InputError, refuses
from ttus_opt.scan.cloud import read_cloud

POINTS = np.random.default_rng(0).uniform(-0.3, 0.3, (12, 3)).round(6)
COLOUR, NORMAL, INTENSITY = [255, 0, 17], [0.0, 0.6, 0.8], [0.5]


def text(more, mark=" ", head=(), tail=""):
    rows = [mark.join(map(str, [*point, *more])) for point in POINTS.tolist()]
    return "\n".join([*head, *rows]) + tail


WRITTEN = {
    "colours.xyz": text(COLOUR),
    "normals.xyz": text(NORMAL, "\t"),
    "intensity.asc": text(INTENSITY, ";"),
    "colours_and_normals.txt": text([*COLOUR, *NORMAL], ","),
    "count.pts": text([*INTENSITY, *COLOUR], head=("12",)),
    "comments.xyz": text(COLOUR, head=("# a scanner", "% of 2024", "// and more", "")),
    "cloud_compare.txt": text(COLOUR, ",", head=("//X,Y,Z,R,G,B", "12")),
    "named_by_comment.xyz": text(NORMAL, head=("# X Y Z nx ny nz",)),
    "paraview.csv": text(
        COLOUR, ",", head=('"Points:0","Points:1","Points:2","R","G","B"',)
    ),
    "trailing.csv": text([], ", ", tail="\n\n# end\n"),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_only_the_coordinates_are_read(name, tmp_path):
    path = tmp_path / name
    path.write_text(WRITTEN[name])
    np.testing.assert_array_equal(read_cloud(path), POINTS)


def test_a_box_crops_a_room(tmp_path):
    room = np.concatenate([1000 * POINTS, [[9000.0, 0.0, 0.0], [0.0, -7000.0, 0.0]]])
    path = tmp_path / "room.npy"
    np.save(path, room)
    with pytest.raises(InputError, match="crop a room to the patient by box="):
        read_cloud(path, unit="mm")
    box = (-0.4, 0.4, -0.4, 0.4, -np.inf, np.inf)
    np.testing.assert_allclose(read_cloud(path, unit="mm", box=box), POINTS)
    half = read_cloud(path, unit="mm", box=(0.0, 0.4, -0.4, 0.4, -1, 1))
    np.testing.assert_allclose(half, POINTS[POINTS[:, 0] >= 0])
    refuses(InputError, "xmin 1 and xmax -1", read_cloud, path, box=(1, -1, 0, 1, 0, 1))
