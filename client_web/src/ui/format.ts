/** Numbers as people read them. */

/** sRGB colour of a lamp's hue: its strongest channel is full. */
export function lampColour(radiance: readonly [number, number, number]): string {
  const strongest = Math.max(...radiance)
  if (strongest <= 0) {
    return 'rgb(70, 70, 70)'
  }
  const [red, green, blue] = radiance.map((value) => Math.round(255 * encodeSrgb(value / strongest)))
  return `rgb(${red}, ${green}, ${blue})`
}

/** The sRGB transfer function (IEC 61966-2-1), linear 0..1 to encoded 0..1. */
export function encodeSrgb(linear: number): number {
  return linear <= 0.0031308 ? 12.92 * linear : 1.055 * linear ** (1 / 2.4) - 0.055
}

export function milliseconds(value: number | null): string {
  if (value === null || !Number.isFinite(value)) {
    return '–'
  }
  return value < 10_000 ? `${Math.round(value)} ms` : `${(value / 1000).toFixed(0)} s`
}

/** Time that adds up, from milliseconds to days. */
export function duration(valueMs: number): string {
  const units: readonly [number, string][] = [
    [86_400_000, 'd'],
    [3_600_000, 'h'],
    [60_000, 'min'],
    [1000, 's'],
  ]
  const [size, name] = units.find(([unitMs]) => valueMs >= unitMs) ?? [1, 'ms']
  const value = valueMs / size
  return `${value < 10 && value > 0 ? value.toFixed(1) : value.toFixed(0)} ${name}`
}

/** A share of a whole in per cent; only nothing is 0 % and only everything 100 %. */
export function share(value: number): string {
  if (value <= 0 || value >= 1) {
    return value <= 0 ? '0 %' : '100 %'
  }
  const percent = 100 * value
  return `${percent < 10 ? Math.max(0.1, percent).toFixed(1) : Math.min(99, percent).toFixed(0)} %`
}

/** Connection in a few words: the age counts only once it can be felt. */
export function withAge(text: string, ageMs: number | null): string {
  return ageMs === null || ageMs < 500 ? text : `${text} · ${milliseconds(ageMs)}`
}

export function bytes(value: number): string {
  return value < 10_000 ? `${value} B` : `${(value / 1000).toFixed(1)} kB`
}

export function perSecond(value: number): string {
  return `${value < 10 ? value.toFixed(1) : value.toFixed(0)} /s`
}

/** Exposure factor as photographic stops with a sign. */
export function stops(exposure: number): string {
  const value = Math.log2(exposure)
  const rounded = Math.abs(value) < 0.05 ? 0 : value
  return `${rounded > 0 ? '+' : rounded < 0 ? '−' : ''}${Math.abs(rounded).toFixed(1)}`
}

/** "ceiling_light" as "Ceiling light". */
export function readableName(name: string): string {
  const words = name.replaceAll(/[_-]+/g, ' ').trim()
  return words === '' ? name : (words[0] ?? '').toUpperCase() + words.slice(1)
}

/** Seconds as photographers read them: "1/250 s", "0.5 s", "40 µs". */
export function exposureTime(timeS: number): string {
  if (timeS >= 0.3) {
    return `${timeS.toFixed(1)} s`
  }
  return timeS >= 1 / 8000 ? `1/${Math.round(1 / timeS)} s` : `${Math.round(1e6 * timeS)} µs`
}
