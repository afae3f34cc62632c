"""Bias in proportion to a magnetic field along one axis."""

from analytics.loop.effects.monomial import Monomial

_REFERENCE = "Bohm, Petermann and Weidel, Optics Letters 7(4), 1982, 180-182; IEEE 952-2020, magnetic sensitivity"
_TEST = "field steps of both signs in a coil, one axis at a time, at constant temperature"
_TEST_ZH = "恒温下用磁场线圈逐轴施加正负磁场阶跃"


class MagneticI(Monomial):
    """Along the input axis."""

    name = "magnetic_i"
    en = "magnetic field, input axis"
    zh = "输入轴磁场"
    needs = ("magnetic_i",)
    powers = (1,)
    per = "{magnetic_i}"
    cause = (
        "Faraday rotation in twisted fibre, or coupling into electric loops, adds a phase in proportion to the field. "
        "Along the input axis it enters by the fibre's axial parts and leads."
    )
    cause_zh = "扭转光纤中的法拉第旋光或电回路耦合产生与磁场成正比的相位。沿输入轴时经由光纤轴向分量和引线进入。"
    reference = _REFERENCE
    aliases = ("magnetic_o", "magnetic_s")
    separating_test = _TEST
    separating_test_zh = _TEST_ZH


class MagneticO(Monomial):
    """Along the output axis."""

    name = "magnetic_o"
    en = "magnetic field, output axis"
    zh = "输出轴磁场"
    needs = ("magnetic_o",)
    powers = (1,)
    per = "{magnetic_o}"
    cause = (
        "A field in the plane of the coil rotates the polarisation in twisted fibre (Faraday effect), and the two "
        "beams do not cancel. The bias is in proportion to the field along this axis."
    )
    cause_zh = "环平面内的磁场使扭转光纤中偏振面旋转（法拉第效应），两束光不能抵消。零偏与该轴磁场成正比。"
    reference = _REFERENCE
    aliases = ("magnetic_i", "magnetic_s")
    separating_test = _TEST
    separating_test_zh = _TEST_ZH


class MagneticS(Monomial):
    """Along the spin axis."""

    name = "magnetic_s"
    en = "magnetic field, spin axis"
    zh = "自转轴磁场"
    needs = ("magnetic_s",)
    powers = (1,)
    per = "{magnetic_s}"
    cause = (
        "A field in the plane of the coil rotates the polarisation in twisted fibre (Faraday effect), and motors or "
        "torquers take up a moment. The bias is in proportion to the field along this axis."
    )
    cause_zh = "环平面内的磁场使扭转光纤中偏振面旋转（法拉第效应），电机或力矩器也受磁力矩。零偏与该轴磁场成正比。"
    reference = _REFERENCE
    aliases = ("magnetic_i", "magnetic_o")
    separating_test = _TEST
    separating_test_zh = _TEST_ZH
