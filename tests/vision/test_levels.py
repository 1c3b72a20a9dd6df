"""Compiled kernels go from one machine to another: their flags name a level of CPUs, never the one that compiles."""

from hrc.vision.kernels.types import MODULE, cpu_flags, cpu_levels


def test_kernels_are_compiled_for_a_level_of_cpus() -> None:
    assert MODULE.options["cpu_compiler_flags"] == cpu_flags()
    assert cpu_flags() in cpu_levels()
    assert len(set(cpu_levels())) == len(cpu_levels())
    assert all("native" not in flags for flags in cpu_levels())
