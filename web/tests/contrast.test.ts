// WCAG AA: 4.5:1 for text, 3:1 for what is drawn, in both themes, computed from the very files.
import { readFileSync } from "node:fs";
import { expect, test } from "vitest";
import { palettes } from "../src/themes/palette";

const css = readFileSync(new URL("../src/themes/page.css", import.meta.url), "utf8");

function variables(block: string): Record<string, string> {
  const body = css.slice(css.indexOf(block)).split("}")[0] ?? "";
  return Object.fromEntries([...body.matchAll(/--([a-z0-9-]+): (#[0-9a-f]{6});/g)].map((found) => [found[1] ?? "", found[2] ?? ""]));
}

function luminance(colour: string): number {
  const [red, green, blue] = [1, 3, 5].map((at) => {
    const value = Number.parseInt(colour.slice(at, at + 2), 16) / 255;
    return value <= 0.040_45 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4;
  });
  return 0.2126 * (red ?? 0) + 0.7152 * (green ?? 0) + 0.0722 * (blue ?? 0);
}

function contrast(a: string, b: string): number {
  const [light, dark] = [luminance(a), luminance(b)].sort((x, y) => y - x);
  return ((light ?? 0) + 0.05) / ((dark ?? 0) + 0.05);
}

const themes = { light: variables(":root {"), dark: variables(':root[data-theme="dark"]') };
const texts = [
  ["text", "bg"], ["text", "panel"], ["text", "raised"], ["text", "selected"], ["text", "bad"], ["muted", "bg"], ["muted", "panel"],
  ["muted", "raised"], ["muted", "selected"], ["muted", "bad"], ["accent", "panel"], ["accent", "selected"], ["on-accent", "accent"],
  ["on-danger", "danger"], ["on-go", "go"], ["on-warn", "warn"], ["on-live", "live"], ["target", "panel"], ["target", "selected"],
  ["danger", "panel"], ["danger", "bad"],
] as const;

for (const theme of ["light", "dark"] as const) {
  test.each(texts)(`${theme}: %s on %s can be read`, (front, back) => {
    const colours = themes[theme];
    expect(contrast(colours[front] ?? "", colours[back] ?? "")).toBeGreaterThanOrEqual(4.5);
  });

  test(`${theme}: what the map draws stands out from its ground`, () => {
    const palette = palettes[theme];
    for (const text of [palette.text, palette.gridText, palette.target, palette.proposal, palette.area, palette.fence]) {
      expect(contrast(text, palette.background)).toBeGreaterThanOrEqual(4.5);
    }
    for (const drawn of [palette.los[0], palette.los[2], palette.unclassified, palette.vehicle]) {
      expect(contrast(drawn, palette.background)).toBeGreaterThanOrEqual(3);
    }
  });

  test(`${theme}: the search map's classes are told apart, and the likeliest from the ground`, () => {
    const colours = palettes[theme].search;
    for (let at = 1; at < colours.length; at += 1) expect(contrast(colours[at - 1] ?? "", colours[at] ?? "")).toBeGreaterThanOrEqual(1.25);
    for (const likely of colours.slice(0, 4)) expect(contrast(likely, palettes[theme].background)).toBeGreaterThanOrEqual(3);
    expect(contrast(colours[6] ?? "", palettes[theme].background)).toBeGreaterThanOrEqual(1.1);
    expect(colours).toEqual(colours.map((_, at) => themes[theme][`search${at}`]));
  });

  test(`${theme}: the legend and the map use the same scale`, () => {
    expect([0, 1, 2].map((at) => themes[theme][`los${at}`])).toEqual(palettes[theme].los);
    expect(themes[theme]["unclassified"]).toBe(palettes[theme].unclassified);
  });
}
