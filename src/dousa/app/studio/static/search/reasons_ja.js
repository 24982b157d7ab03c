// A reason as a Japanese sentence. Reasons come in English with all their numbers; the sentence is made anew from these.

const PARTS = [
  ["lower foot", "低いほうの足"], ["shoulder", "肩"], ["elbow", "肘"], ["wrist", "手首"], ["hand", "手"], ["hip", "股関節"], ["knee", "膝"], ["foot", "足"],
  ["toe", "つま先"], ["leg", "脚"], ["arm", "腕"], ["head", "頭"], ["neck", "首"], ["spine", "背骨"], ["pelvis", "骨盤"], ["trunk", "胴"], ["body", "体"],
];

/** "the left elbow" -> "左肘" */
function part(name) {
  const bare = name.replace(/^the /, "");
  const [side, rest] = bare.startsWith("left ") ? ["左", bare.slice(5)] : bare.startsWith("right ") ? ["右", bare.slice(6)] : ["", bare];
  return side + (PARTS.find(([english]) => english === rest)?.[1] ?? rest);
}

const SIZE = ["大きく", "小さく"];
const PLUS = ["", "−"];
/** What is measured along a line: signs says the two ways, degrees to which of them it lies farther. */
const ALONG = {
  side: { name: "左右", signs: ["左へ", "右へ"], degrees: ["左寄りに", "右寄りに"] },
  other: { name: "左右", signs: ["右へ", "左へ"], degrees: ["右寄りに", "左寄りに"] },
  up: { name: "上下", signs: ["上へ", "下へ"], degrees: ["上寄りに", "下寄りに"] },
  front: { name: "前後", signs: ["前へ", "後ろへ"], degrees: ["前寄りに", "後ろ寄りに"] },
};
const WAYS = { "to the left": ALONG.side, "left of": ALONG.side, left: ALONG.side, "right of": ALONG.other, upwards: ALONG.up, above: ALONG.up, forwards: ALONG.front, forward: ALONG.front, "in front of": ALONG.front };
const SEEN = { front: "正面", side: "右横", above: "上" };
const TURNS = { front: ["反時計回り", "時計回り"], side: ["時計回り", "反時計回り"], above: ["反時計回り", "時計回り"] };

const along = (noun, way) => ({ noun: noun(WAYS[way].name), signs: WAYS[way].signs, degrees: WAYS[way].degrees });

function place(one, way, from) {
  if (way === "above") return { noun: `${part(one)}の高さ（${part(from)}から）`, signs: ["", "下へ"], degrees: ["高く", "低く"] };
  return along((name) => `${part(one)}の${name}の位置（${part(from)}から）`, way.replace("to the ", ""));
}

function curve(one, plane) {
  return { noun: `${part(one)}の曲がり方（${SEEN[plane]}から見て）`, signs: TURNS[plane].map((turn) => `${turn}に`), degrees: TURNS[plane].map((turn) => `${turn}寄りに`) };
}

const CHANNELS = [
  [/^distance (.+) - (.+)$/, (a, b) => ({ noun: `${part(a)}と${part(b)}の距離`, signs: PLUS, degrees: ["長く", "短く"] })],
  [/^(.+?) ((?:to the )?(?:left|right) of|above|in front of) (.+)$/, place],
  [/^speed of (.+)$/, (one) => ({ noun: `${part(one)}の速さ`, signs: PLUS, degrees: ["速く", "遅く"] })],
  [/^(.+) moving (to the left|upwards|forwards)$/, (one, way) => along((name) => `${part(one)}の${name}の動き`, way)],
  [/^(.+) turning (to the left)$/, (one, way) => along((name) => `${part(one)}の${name}の回転`, way)],
  [/^(trunk) leaning (left|forward)$/, (one, way) => along((name) => `${part(one)}の${name}の傾き`, way)],
  [/^(trunk) away from upright$/, (one) => ({ noun: `${part(one)}の傾き`, signs: PLUS, degrees: SIZE })],
  [/^(.+) heading (to the left|upwards|forwards)$/, (one, way) => along((name) => `${part(one)}の進む向き（${name}）`, way)],
  [/^(.+) curving, seen from (?:the )?(front|side|above)$/, curve],
  [/^duration$/, () => ({ noun: "動きの長さ", signs: PLUS, degrees: ["長く", "短く"] })],
];

function wordsOf(channel) {
  for (const [form, make] of CHANNELS) {
    const found = form.exec(channel);
    if (found) return make(...found.slice(1));
  }
  return { noun: part(channel), signs: PLUS, degrees: SIZE };
}

const DEGREES = 180 / Math.PI;
/** Unit -> factor, digits, and what stands before and after the number. */
const UNITS = {
  "body heights": [1, 2, "身長の ", " 倍"],
  "body heights a second": [1, 2, "毎秒身長の ", " 倍"],
  radians: [DEGREES, 0, "", " 度"],
  "radians a second": [DEGREES, 0, "毎秒 ", " 度"],
  "share of its speed": [100, 0, "速さの ", " %"],
  degrees: [1, 0, "", " 度"],
  s: [1, 1, "", " 秒"],
};

/** Writes numbers of a reason; one more digit where that tells a value from the bound. */
function measureOf({ unit, value, other_value, threshold }) {
  const [factor, digits, before, after] = UNITS[unit] ?? [1, 2, "", ` ${unit}`];
  const written = (number, places) => Math.abs(factor * number).toFixed(places);
  const close = [value, other_value].some((one) => one !== undefined && written(one, digits) === written(threshold, digits));
  return { write: (number) => written(number, digits + (close ? 1 : 0)), before, after };
}

/** A space before a bare number. */
const spaced = (text) => (/^\d/.test(text) ? ` ${text}` : text);

function sayValues({ value, other_value }, signs, { write, before, after }) {
  const say = (number) => `${signs[number < 0 ? 1 : 0]}${before}${write(number)}${after}`;
  const there = other_value === undefined || say(other_value) === say(value) ? "" : `（相手は${spaced(say(other_value))}）`;
  return spaced(say(value)) + there;
}

/** Where the others are: beyond the bound. */
function sayOthers({ above, threshold, others, away }, signs, { write, before, after }) {
  const share = away / (others + 4); // of few, cautiously, as in the English sentence
  const who = share >= 0.5 ? "多くの動き" : share >= 0.25 ? "かなりの動き" : "一部の動き";
  const [positive, number] = [threshold >= 0, write(threshold)];
  if (!Number(number) && signs[0]) return `${who}（${signs[above ? 1 : 0]}）`;
  return `${who}（${signs[positive ? 0 : 1]}${before}${number}${after}${above === positive ? "未満" : "超"}）`;
}

const span = (start, end) => `${start.toFixed(1)}〜${end.toFixed(1)} 秒`;

function sayWhen({ text, start, end, other_start, other_end }) {
  if (text.includes("over the whole motion")) return "動き全体";
  const same = other_start === undefined || Math.abs(other_start - start) + Math.abs(other_end - end) < 0.1;
  return span(start, end) + (same ? "" : `（相手は ${span(other_start, other_end)}）`);
}

/** "左肘の高さ（骨盤から）は、1.5〜3.5 秒の平均が身長の 0.29 倍で、多くの動き（身長の 0.20 倍未満）より高くなっています。" */
export function sayJapanese(reason) {
  const { noun, signs, degrees } = wordsOf(reason.channel);
  const measure = measureOf(reason);
  const ways = reason.kind === "spread" ? PLUS : signs;
  const degree = (reason.kind === "mean" ? degrees : reason.kind === "trend" && signs[0] ? degrees : SIZE)[reason.above ? 0 : 1];
  const what = { mean: "の平均", spread: "の変わり幅", trend: "の変化" }[reason.kind] ?? "";
  const end = `が${sayValues(reason, ways, measure)}で、${sayOthers(reason, ways, measure)}より${degree}なっています。`;
  if (reason.channel === "duration") return noun + end;
  return `${noun}は、${sayWhen(reason)}${what}${end}`;
}
