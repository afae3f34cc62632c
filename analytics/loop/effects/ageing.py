"""Bias that runs away over days."""

from analytics.loop.effects.monomial import Monomial


class Ageing(Monomial):
    """Bias in proportion to calendar time."""

    name = "ageing"
    en = "ageing over days"
    zh = "长期老化"
    needs = ("day",)
    powers = (1,)
    per = "day"
    cause = (
        "Source power, adhesive and getter age over days to years, on the shelf and in use. The bias moves from run "
        "to run in one direction."
    )
    cause_zh = "光源功率、胶粘剂和吸气剂在存放与使用中逐日老化。零偏在各次测试之间朝一个方向移动。"
    reference = "IEEE 952-2020, bias stability over time; GJB 2426A-2004, long-term repeatability"
    aliases = ("drift_in_run",)
    separating_test = "repeat the same power-on test on eight or more days spread over weeks"
    separating_test_zh = "在数周内分八天以上重复同样的通电测试"
