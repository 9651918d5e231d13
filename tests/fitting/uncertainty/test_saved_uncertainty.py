"""Uncertainty that is written and read back."""

import json
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

import ttus_opt as tt
from tests.fitting.uncertainty.test_covariance_posterior import exact, fitted
from tests.fitting.uncertainty.test_field_uncertainty import (
    KEPT_SHARE,
    three_presses,
    unseen,
)
from ttus_opt.core import io
from ttus_opt.core.errors import FileError, InputError
from ttus_opt.fitting.uncertainty.saved_uncertainty import (
    FACTS,
    read_uncertainty,
    save_with_uncertainty,
)
from ttus_opt.voxmap.field import DRAWS, KIND, VERSION, PotentialField

pytestmark = pytest.mark.filterwarnings(KEPT_SHARE)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("uncertainty") / "field.nc"
    save_with_uncertainty(fitted().field, exact(), path, count=40, depth=0.02)
    return path


def test_what_is_read_is_what_was_written(file):
    shell = three_presses().shell
    found, drawn = read_uncertainty(file, shell), exact().sampled(40, 0.02)
    told, own = found.std(unseen()), drawn.std(unseen())
    np.testing.assert_allclose(told.force, own.force, rtol=2e-3)
    np.testing.assert_allclose(told.torque, own.torque, rtol=2e-3)
    np.testing.assert_allclose(told.noise, own.noise, rtol=1e-12)
    assert found.noise == exact().noise and told.known.all()
    assert np.array_equal(found.potential.values, fitted().field.values)


def test_a_frame_deeper_than_the_draws_is_unknown(file):
    far = replace(unseen(), position=0.4 * unseen().position)
    assert not read_uncertainty(file, three_presses().shell).std(far).known.any()


def test_a_renderer_takes_the_map_of_the_file(file):
    potential, shell = PotentialField.load(file), three_presses().shell
    pose = unseen().rotation[0], unseen().position[0]
    given = tt.Renderer(potential, shell, uncertainty=potential.uncertainty).render(
        *pose
    )
    assert tt.Renderer(potential, shell, uncertainty=True).render(*pose).force_std == (
        given.force_std
    )
    assert given.force_std > 0.0


def test_files_without_uncertainty_or_with_a_damaged_one_are_refused(file, tmp_path):
    shell = three_presses().shell
    fitted().field.save(tmp_path / "plain.nc")
    with pytest.raises(InputError, match="fit again with ttus-opt fit --uncertainty"):
        read_uncertainty(tmp_path / "plain.nc", shell)
    whole = xr.load_dataset(file, engine="netcdf4")
    facts = json.loads(whole.attrs[FACTS])
    short = whole.isel(uncertainty_voxel=slice(10))
    spoilt = [
        {},
        *({**facts, "depth": depth} for depth in (np.nan, 1e300, 0.0)),
        {**facts, "noise": {**facts["noise"], "force": -1.0}},
        {**facts, "noise": {**facts["noise"], "share": np.nan}},
        {**facts, "noise": {}},
        {**facts, "noise": 0.2},
        {**facts, "sizes": [0.0]},
        {**facts, "sizes": [np.nan] * len(facts["sizes"])},
    ]
    bent = whole.copy()
    bent[DRAWS] = whole[DRAWS].assign_attrs(factor=np.nan)
    others = [whole.assign_attrs({FACTS: json.dumps(each)}) for each in spoilt]
    for damaged in (short, bent, *others):
        io.write_dataset(damaged, tmp_path / "d.nc", kind=KIND, version=VERSION)
        with pytest.raises(FileError, match="damaged uncertainty"):
            read_uncertainty(tmp_path / "d.nc", shell)
    assert DRAWS in whole and DRAWS not in PotentialField.load(file).to_xarray()
