"""Units of measure in Chinese words."""

CHINESE_UNITS = {
    "度": "deg", "度/秒": "deg/s", "度/s": "deg/s", "deg/秒": "deg/s", "度/小时": "deg/h", "度/时": "deg/h",
    "度/h": "deg/h", "deg/小时": "deg/h", "deg/时": "deg/h", "度每秒": "deg/s", "度每小时": "deg/h", "度每时": "deg/h",
    "°/小时": "deg/h", "°/时": "deg/h", "°/秒": "deg/s", "弧度": "rad", "弧度/秒": "rad/s", "角秒": "arcsec",
    "角分": "arcmin", "摄氏度": "degC", "秒": "s", "毫秒": "ms", "微秒": "us", "分": "min", "分钟": "min", "小时": "h",
    "时": "h", "伏": "V", "毫伏": "mV", "安": "A", "毫安": "mA", "瓦": "W", "赫兹": "Hz", "欧": "ohm", "欧姆": "ohm",
    "千欧": "kohm", "兆欧": "Mohm", "兆欧姆": "Mohm", "米/秒": "m/s", "米/秒²": "m/s^2", "脉冲": "count",
    "脉冲数": "count", "个": "count", "脉冲/秒": "count/s", "脉冲/s": "count/s", "转/分": "rpm", "转/分钟": "rpm",
    "转/秒": "turn/s", "转每分": "rpm", "转每分钟": "rpm", "转每秒": "turn/s", "弧度每秒": "rad/s", "毫弧度": "mrad",
    "毫弧度/秒": "mrad/s", "毫弧度每秒": "mrad/s", "角秒/秒": "arcsec/s", "角秒每秒": "arcsec/s", "度/分": "deg/min",
    "度每分": "deg/min", "度/分钟": "deg/min", "度每分钟": "deg/min", "微伏": "uV", "微安": "uA", "千赫": "kHz",
    "米每秒": "m/s", "米/秒^2": "m/s^2", "米每二次方秒": "m/s^2", "米每平方秒": "m/s^2", "帕": "Pa", "百帕": "hPa",
    "千帕": "kPa", "天": "day",
}  # fmt: skip
