"""Curves of a run as CSV and as a picture (SVG)."""
import math
from xml.sax.saxutils import escape

ERRORS = ('loss', 'median_px', 'mean_px', 'below_1px')
COLOURS = {'training': '#888888', 'validation': '#0060c0', 'test': '#c04000'}
WIDTH, HEIGHT, LEFT, TOP, GAP = 460, 300, 60, 46, 90


def columns(parts):
    return (['step', 'epoch', 'seconds', 'learning_rate', 'training_loss']
            + [f'{part}_{error}' for part in parts for error in ERRORS])


def csv(rows, baselines):
    """Rows of the run; before them one of each reference, whose step is its name."""
    parts = list(baselines['initial'])
    names = columns(parts)
    lines = [','.join(names)]
    for name, values in baselines.items():
        flat = {f'{part}_{error}': value for part, errors in values.items() for error, value in errors.items()}
        lines.append(','.join([name] + [f'{flat[c]:.6g}' if c in flat else '' for c in names[1:]]))
    for row in rows:
        lines.append(','.join(f'{row[c]:.6g}' if isinstance(row[c], float) else str(row[c]) for c in names))
    return '\n'.join(lines) + '\n'


def nice_steps(low, high, count=5):
    raw = max(high - low, 1e-12) / count
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(m * power for m in (1, 2, 5, 10) if m * power >= raw)
    return [i * step for i in range(math.ceil(low / step), math.floor(high / step) + 1)]


def panel(number, title, lines, references, last_step):
    """`lines`: {part: [(step, value)]}; `references`: [(name, part, value)]. The upright axis is logarithmic."""
    x0 = LEFT + number * (WIDTH + GAP)
    values = [v for points in lines.values() for _, v in points] + [v for _, _, v in references]
    values = [math.log10(v) for v in values if v > 0 and math.isfinite(v)]
    if not values:
        return []
    low, high = min(values), max(values)
    margin = 0.05 * (high - low) + 0.02
    low, high = low - margin, high + margin

    def x(step):
        return x0 + WIDTH * step / max(last_step, 1)

    def y(value):
        return TOP + HEIGHT * (high - math.log10(max(value, 1e-9))) / (high - low)
    out = [f'<text x="{x0}" y="{TOP - 14}" font-weight="bold">{escape(title)}</text>',
           f'<rect x="{x0}" y="{TOP}" width="{WIDTH}" height="{HEIGHT}" fill="none" stroke="#aaa"/>']
    ticks = [m * 10.0 ** e for e in range(math.floor(low), math.ceil(high) + 1) for m in (1, 2, 5)]
    for tick in (t for t in ticks if low <= math.log10(t) <= high):
        out.append(f'<line x1="{x0}" x2="{x0 + WIDTH}" y1="{y(tick):.1f}" y2="{y(tick):.1f}" stroke="#eee"/>'
                   f'<text x="{x0 - 6}" y="{y(tick) + 4:.1f}" text-anchor="end">{tick:g}</text>')
    for tick in nice_steps(0, last_step):
        out.append(f'<text x="{x(tick):.1f}" y="{TOP + HEIGHT + 16}" text-anchor="middle">{tick:g}</text>')
    out.append(f'<text x="{x0 + WIDTH / 2}" y="{TOP + HEIGHT + 34}" text-anchor="middle">step</text>')
    for name, part, value in references:
        dash = '2 4' if name == 'initial' else '8 4'
        out.append(f'<line x1="{x0}" x2="{x0 + WIDTH}" y1="{y(value):.1f}" y2="{y(value):.1f}" stroke="{COLOURS[part]}" '
                   f'stroke-dasharray="{dash}"/><text x="{x0 + WIDTH - 4}" y="{y(value) - 4:.1f}" text-anchor="end" '
                   f'fill="{COLOURS[part]}">{name}, {part}</text>')
    for part, points in lines.items():
        path = ' '.join(f'{x(step):.1f},{y(value):.1f}' for step, value in points if math.isfinite(value))
        out.append(f'<polyline points="{path}" fill="none" stroke="{COLOURS[part]}" stroke-width="2"/>')
    return out


def svg(title, rows, baselines, last_step):
    parts = list(baselines['initial'])

    def lines(error, names):
        return {part: [(row['step'], row[f'{part}_{error}']) for row in rows] for part in names}

    def references(error):
        return [(name, part, values[part][error]) for name, values in baselines.items() for part in parts]
    body = panel(0, 'loss', lines('loss', ['training', *parts]), references('loss'), last_step)
    body += panel(1, 'median error after alignment, px', lines('median_px', parts), references('median_px'), last_step)
    width, height = LEFT + 2 * WIDTH + GAP + 20, TOP + HEIGHT + 70
    for i, part in enumerate(['training', *parts]):
        body.append(f'<text x="{LEFT + 90 * i}" y="{height - 10}" fill="{COLOURS[part]}">&#8212; {part}</text>')
    body.append(f'<text x="{width - 20}" y="{height - 10}" text-anchor="end">{escape(title)}; initial: no motion; classical: '
                'grey pyramid, unit weights</text>')
    return (f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
            'font-family="sans-serif" font-size="12"><rect width="100%" height="100%" fill="white"/>\n'
            + '\n'.join(body) + '\n</svg>\n')
