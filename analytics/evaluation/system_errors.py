"""Texts of the operating system's errors in Chinese, as they stand in notes and reasons."""

import errno
import os
import re
from functools import cache

_CHINESE = {
    errno.EPERM: "操作不允许",
    errno.ENOENT: "没有该文件或目录",
    errno.EINTR: "系统调用被中断",
    errno.EIO: "输入/输出错误",
    errno.ENXIO: "没有该设备或地址",
    errno.EBADF: "文件描述符无效",
    errno.EAGAIN: "资源暂时不可用",
    errno.ENOMEM: "内存不足",
    errno.EACCES: "权限不足",
    errno.EBUSY: "设备或资源忙",
    errno.EEXIST: "文件已存在",
    errno.EXDEV: "跨设备的链接无效",
    errno.ENODEV: "没有该设备",
    errno.ENOTDIR: "不是目录",
    errno.EISDIR: "是一个目录",
    errno.EINVAL: "参数无效",
    errno.ENFILE: "系统打开的文件过多",
    errno.EMFILE: "打开的文件过多",
    errno.EFBIG: "文件过大",
    errno.ENOSPC: "设备上没有剩余空间",
    errno.EROFS: "文件系统只读",
    errno.EPIPE: "管道已断开",
    errno.ENAMETOOLONG: "文件名过长",
    errno.ENOTEMPTY: "目录非空",
    errno.ELOOP: "符号链接层数过多",
    errno.EDQUOT: "超出磁盘配额",
    errno.ESTALE: "文件句柄已失效",
    errno.EADDRINUSE: "地址已被占用",
    errno.EADDRNOTAVAIL: "无法使用所请求的地址",
    errno.ENETDOWN: "网络已断开",
    errno.ENETUNREACH: "网络不可达",
    errno.ECONNABORTED: "连接被中止",
    errno.ECONNRESET: "连接被对方重置",
    errno.ENOTCONN: "传输端点尚未连接",
    errno.ETIMEDOUT: "连接超时",
    errno.ECONNREFUSED: "连接被拒绝",
    errno.EHOSTDOWN: "主机已关闭",
    errno.EHOSTUNREACH: "没有到主机的路由",
}


def system_error(text: str) -> tuple[str, str, str] | None:
    """What stands before an error of the system, the error in Chinese, and its file or address; None if it is none.

    >>> system_error("[Errno 28] No space left on device: '/data/lake'")
    ('', '设备上没有剩余空间', "'/data/lake'")
    >>> system_error("/data/lake: Input/output error")
    ('/data/lake', '输入/输出错误', '')
    >>> system_error("the disk is full") is None
    True
    """
    match = _pattern().fullmatch(text)
    if match is None:
        return None
    return match["before"] or "", _by_text()[match["what"]], match["of"] or ""


@cache
def _by_text() -> dict[str, str]:
    return {os.strerror(code): chinese for code, chinese in _CHINESE.items()}


@cache
def _pattern() -> re.Pattern[str]:
    """An error as `str` of an OSError has it, or its text alone, perhaps after a name."""
    texts = "|".join(map(re.escape, sorted(_by_text(), key=len, reverse=True)))
    return re.compile(rf"(?:(?P<before>.+?): )?(?:\[Errno -?\d+\] )?(?P<what>{texts})(?:: (?P<of>'.+'))?", re.DOTALL)
