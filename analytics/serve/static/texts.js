// Texts of the scripts in both languages; those of the pages are in pages/texts.toml.
const TEXTS = {
  en: {
    floor: "{n} units by verdict so far; arrow keys move, Enter opens the unit",
    open: "undecided", PASS: "PASS", FAIL: "FAIL", MARGINAL: "MARGINAL", NO_DATA: "NO DATA", ABORTED: "ABORTED", early: " (early)", silent: "silent", released: "released", left: "{time} left", nearest: "at {ratio} of its limit",
    live: "live, {time}", away: "the connection is lost; trying again", signed_out: "signed out, or refused by the server: load this page again", count: "{n} {word}",
    signal: "{signal} in {unit}, least and greatest value of each of {n} stretches; arrow keys read values, plus and minus zoom, 0 shows all",
    bucket: "{time}: {lo} to {hi}, mean {mean} {unit}", sample: "{time}: {value} {unit}", none: "no samples in this stretch",
    beside: "beside it", nothing: "nothing", loading: "loading", failed: "{why}",
    computed: "Computed from all samples.",
    allan: "Allan deviation over averaging time, both logarithmic, with 95 % bounds; arrow keys read values",
    point: "{tau} s: {value} ({lo} to {hi}) {unit}", trend: "{name}: values in the order of time with control limits; arrow keys read values",
    value: "{time}, {unit}: {value}", tau: "averaging time / s", centre: "centre", limits: "control limits",
    history: "earlier statements", rows: "{n} rows in {s} s", cut: "cut at {n}", plot: "first column of numbers or times across, the others up",
    course: "{what}: commanded and measured over time; arrow keys read values", commanded: "commanded", current: "going on",
    at: "{time}: {values}", allans: "Allan deviation of {n} units over averaging time, both logarithmic, with 95 % bounds and limits; arrow keys read values",
    answered: "{action}: {text}", waiting: "waiting for the station", angle_random_walk: "angle random walk", allan_deviation: "Allan deviation",
    of_limit: "{unit}, {name} at {tau} s, {limit}: {upper} {measure}: ",
    limit_below: "below the limit", limit_above: "above the limit", limit_across: "the bounds span the limit", limit_none: "the record is not long enough yet",
    rate: "rate / (deg/s)", temperature: "temperature / degC",
    least: "least", greatest: "greatest", mean: "mean", bound: "95 % bounds", deviation: "deviation",
    figure: "{title}, {n} curves; arrow keys read values, Enter opens what a point is of", bounds: " ({lo} to {hi})", across: "across", up: "up", by: "a curve for each", link: "link to this query", insert: "write {name} into the statement", more: "and {n} more", limit: "limit of the specification", control: "control limits",
  },
  zh: {
    floor: "{n}个产品按当前判定着色；方向键移动，回车打开产品",
    open: "未判定", PASS: "合格", FAIL: "不合格", MARGINAL: "临界", NO_DATA: "无数据", ABORTED: "中止", early: "（提前）", silent: "无信号", released: "已释放", left: "剩余{time}", nearest: "达到限值的{ratio}倍",
    live: "实时，{time}", away: "连接中断，正在重试", signed_out: "登录已失效或被服务器拒绝：请重新加载本页", count: "{word} {n}",
    signal: "{signal}（{unit}），{n}个区间的最小值与最大值；方向键读数，加减号缩放，0显示全部",
    bucket: "{time}：{lo}至{hi}，均值{mean} {unit}", sample: "{time}：{value} {unit}", none: "该区间无采样",
    beside: "并列显示", nothing: "无", loading: "读取中", failed: "{why}",
    computed: "由全部采样计算。",
    allan: "Allan 标准差随平均时间变化，双对数坐标，含95%置信界；方向键读数",
    point: "{tau} s：{value}（{lo}至{hi}）{unit}", trend: "{name}：按时间排列的数值与控制限；方向键读数",
    value: "{time}，{unit}：{value}", tau: "平均时间 / s", centre: "中心线", limits: "控制限",
    history: "以往语句", rows: "{n}行，{s} s", cut: "在{n}行截断", plot: "横轴为第一列数值或时间，其余为纵轴",
    course: "{what}：指令值与实测值随时间变化；方向键读数", commanded: "指令值", current: "进行中",
    at: "{time}：{values}", allans: "{n}个产品的Allan 标准差随平均时间变化，双对数坐标，含95%置信界与限值；方向键读数",
    answered: "{action}：{text}", waiting: "等待试验台答复", angle_random_walk: "角度随机游走系数", allan_deviation: "Allan 标准差",
    of_limit: "{unit}，{tau} s 处的{name}，{limit}：{upper} {measure}：",
    limit_below: "低于限值", limit_above: "高于限值", limit_across: "置信界跨越限值", limit_none: "记录长度尚不足",
    rate: "角速率 / (deg/s)", temperature: "温度 / degC",
    least: "最小值", greatest: "最大值", mean: "均值", bound: "95%置信界", deviation: "标准差",
    figure: "{title}，{n}条曲线；方向键读数，回车打开该点的来源", bounds: "（{lo}至{hi}）", across: "横轴", up: "纵轴", by: "按此分曲线", link: "此查询的链接", insert: "将{name}写入语句", more: "另有{n}条", limit: "规范限值", control: "控制限",
  },
};

export const LANG = document.documentElement.lang.startsWith("zh") ? "zh" : "en";

/** A text of the page's language with its parts filled in. */
export function say(key, parts = {}) {
  return TEXTS[LANG][key].replace(/\{(\w+)\}/g, (_, name) => parts[name] ?? "");
}

/** A number with four significant digits. */
export function figure(value) {
  return value === null || value === undefined || Number.isNaN(value) ? "–" : String(Number(value.toPrecision(4)));
}

const CLOCKS = new Map();

function clockOf(zone) {
  if (!CLOCKS.has(zone)) {
    const two = "2-digit", options = {year: "numeric", month: two, day: two, hour: two, minute: two, second: two, fractionalSecondDigits: 3, hourCycle: "h23"};
    let found;
    try {
      found = {zone, format: new Intl.DateTimeFormat("en-GB", {...options, timeZone: zone})};
    } catch { // a zone that this browser does not know
      found = {zone: "UTC", format: new Intl.DateTimeFormat("en-GB", {...options, timeZone: "UTC"})};
    }
    CLOCKS.set(zone, found);
  }
  return CLOCKS.get(zone);
}

/** The time zone of the page. */
export const ZONE = clockOf(document.body.dataset.zone || "UTC").zone;

/** What clock and calendar of a time zone show: date, and time to the millisecond. */
export function local(seconds, zone = ZONE) {
  const parts = Object.fromEntries(clockOf(zone).format.formatToParts(new Date(Math.round(seconds * 1e3))).map(each => [each.type, each.value]));
  return {date: `${parts.year}-${parts.month}-${parts.day}`, time: `${parts.hour}:${parts.minute}:${parts.second}.${parts.fractionalSecond}`};
}

/** A moment in a time zone, which is named, as fine as `span` seconds need. */
export function moment(seconds, span = 0, zone = ZONE) {
  const {date, time} = local(seconds, zone);
  return `${date} ${time.slice(0, span && span < 10 ? 12 : 8)}${offset(seconds, zone)} ${clockOf(zone).zone}`;
}

/** The offset from UTC of a moment that clocks show twice, as summer time ends; else nothing. */
function offset(seconds, zone) {
  const shown = at => Object.values(local(at, zone)).join(" ");
  if (![seconds - 3600, seconds + 3600].some(at => shown(at) === shown(seconds))) return "";
  const {date, time} = local(seconds, zone), ahead = Math.round((Date.parse(`${date}T${time}Z`) / 1e3 - seconds) / 60);
  return `${ahead < 0 ? "-" : "+"}${String(Math.floor(Math.abs(ahead) / 60)).padStart(2, "0")}:${String(Math.abs(ahead) % 60).padStart(2, "0")}`;
}

/** A duration. */
export function duration(seconds) {
  const minutes = Math.round(seconds / 60);
  return minutes < 1 ? `${Math.round(seconds)} s` : minutes < 60 ? `${minutes} min` : `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}

/** An element with properties and children; text is never taken for markup. */
export function element(name, properties = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(properties)) {
    if (key.includes("-") || key === "role" || key === "scope") made.setAttribute(key, value); else made[key] = value;
  }
  made.append(...children);
  return made;
}

/** JSON of an address; an Error with the server's sentence where it refuses. */
export async function asked(url, options = {}) {
  const answer = await fetch(url, {headers: {Accept: "application/json", ...options.headers}, ...options});
  const body = await answer.json();
  if (!answer.ok) {
    const message = body.error?.message ?? body.message ?? body.error ?? answer.statusText;
    throw Object.assign(new Error(message), {status: answer.status});
  }
  return body;
}

/** What a person reads when an answer did not come. */
export function trouble(error) {
  if (error instanceof TypeError) return say("away");
  return error.status === 401 ? say("signed_out") : error.message;
}
