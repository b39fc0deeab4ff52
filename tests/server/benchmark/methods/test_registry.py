from nearfield_server.benchmark.methods import METHODS
from nearfield_server.benchmark.methods.light import AtlasSample, Surroundings


def test_every_baseline_says_where_it_is_printed_and_makes_the_lights_asked_for(
    around: Surroundings, lamp_sample: AtlasSample
) -> None:
    own = [name for name, entry in METHODS.items() if not entry.source]
    assert own == ["nearfield"]
    for name, entry in METHODS.items():
        if name in own:
            continue
        assert not entry.form.indirect_exchange
        assert not entry.form.fixture_rays
        assert entry.form.transfer != "full"
        lights = entry.light_counts[0]
        light = entry.make(around, lights, lambda count: 1 / 0).extract(lamp_sample)
        assert len(light.vals) == lights
        assert light.object_sh.shape == (2, 9, 3)
