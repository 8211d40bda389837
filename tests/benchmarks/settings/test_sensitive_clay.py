"""Each row of the clays is of the scene's soil with what that clay has, the first without any of it."""

from benchmarks.settings import sensitive_clay


def test_each_row_is_of_the_soil_with_what_its_clay_has(monkeypatch, tmp_path):
    asked = []

    def slid(campaign, grid):
        soil = campaign.soil
        numerics = campaign.grids[grid]
        assert numerics.spacing == (numerics.cell / 2,) * 2
        asked.append((campaign.site.height, soil.rate_coefficient, soil.strain_95, soil.viscosity, numerics.cell))
        return {**dict.fromkeys(sensitive_clay.COUNTED, 1.0), "runout_m": 30.0 - (soil.viscosity or 0.0) / 100}

    monkeypatch.setattr(sensitive_clay, "slid", slid)
    monkeypatch.setattr(sensitive_clay, "of_dam", lambda cell, viscosity: {"dam": f"{viscosity}", "runout_m": cell})
    monkeypatch.setattr(sensitive_clay, "ROOT", tmp_path)
    values = sensitive_clay.run(quick=False).values
    low = [(None, 0.6, None), (0.1, 0.6, None), (None, 10.0, None), (None, 0.6, 2.5), (None, 0.6, 400.0)]
    slopes = [(5.0, *clay) for clay in low] + [(8.0, None, 0.6, None), (8.0, None, 0.6, 400.0)]
    assert asked == [(*slope, cell) for slope in slopes for cell in (0.5, 0.25, 0.125)]
    assert (values["5_m_as_published_runout_m"], values["8_m_viscosity_of_400_Pa_s_runout_m"]) == (30.0, 26.0)
    assert values["dam_None_runout_m"] == 0.125  # the finest cells
