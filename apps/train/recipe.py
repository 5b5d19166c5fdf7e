"""Recipes: TOML files whose every key has a default, a type and a check."""
import copy
import os
import tomllib

import appearance

HERE = os.path.dirname(os.path.abspath(__file__))


class InputError(Exception):
    """Something that was given is wrong; the message names it and the remedy."""


def load_toml(path):
    try:
        with open(path, 'rb') as file:
            return tomllib.load(file)
    except OSError as e:
        names = sorted(f[:-5] for f in os.listdir(os.path.join(HERE, 'recipes')) if f.endswith('.toml'))
        raise InputError(f'recipe {path}: {e.strerror}; give a TOML file or one of {", ".join(names)}') from None
    except tomllib.TOMLDecodeError as e:
        raise InputError(f'recipe {path}: not TOML: {e}') from None


def merge(base, changes, where):
    """base with changes; keys and types must be those of base."""
    for key, value in changes.items():
        name = f'{where}{key}'
        if key not in base:
            raise InputError(f'{name} is not a key of a recipe; keys are: {", ".join(base)}')
        old = base[key]
        if isinstance(old, float) and type(value) is int:
            value = float(value)
        if type(value) is not type(old):
            raise InputError(f'{name} is {value!r}; its type must be that of {old!r}')
        if isinstance(old, dict):
            merge(old, value, name + '.')
        else:
            base[key] = value
    return base


def setting(text):
    """'data.batch=2' -> {'data': {'batch': 2}}"""
    key, equals, value = text.partition('=')
    if not equals:
        raise InputError(f'--set {text}: must be KEY=VALUE, such as data.batch=2')
    try:
        parsed = tomllib.loads(f'x = {value}')['x']
    except tomllib.TOMLDecodeError:
        parsed = value
    for part in reversed(key.strip().split('.')):
        parsed = {part: parsed}
    return parsed


def load(name, settings=()):
    """The recipe of a file, or of a name in recipes/, over the defaults, with --set's changes; checked."""
    path = name if os.path.sep in name or name.endswith('.toml') else os.path.join(HERE, 'recipes', name + '.toml')
    recipe = merge(copy.deepcopy(load_toml(os.path.join(HERE, 'recipes', 'ours.toml'))), load_toml(path), '')
    for text in settings:
        merge(recipe, setting(text), '')
    check(recipe)
    return recipe


def check(recipe):
    def need(ok, key, rule):
        section, _, item = key.rpartition('.')
        if not ok:
            raise InputError(f'{key} is {recipe[section][item] if section else recipe[item]!r}, {rule}')
    model, data, loss = recipe['model'], recipe['data'], recipe['loss']
    if not model['encoder_dilations']:
        model['encoder_dilations'] = [[1, 2, 2][:len(level)] for level in model['encoder_channels']]
    for network in ('encoder', 'm_estimator'):
        sizes, dilations = model[network + '_channels'], model[network + '_dilations']
        shape = [[len(level) for level in x] if network == 'encoder' else len(x) for x in (sizes, dilations)]
        need(shape[0] == shape[1], f'model.{network}_dilations', f'must have the lengths of {network}_channels, {sizes}')
    need(model['normalisation'] in ('fixed', 'image'), 'model.normalisation', 'must be fixed or image')
    need(model['encoder_channels'] and all(model['encoder_channels']), 'model.encoder_channels', 'must have a list a level')
    need(not model['m_estimator_channels'] or model['m_estimator_channels'][-1] == 1, 'model.m_estimator_channels',
         'must end with 1')
    need(data['batch'] >= 1, 'data.batch', 'must be 1 or more')
    need(len(data['crop']) in (0, 2) and all(x >= 32 for x in data['crop']), 'data.crop',
         'must be [width, height] of 32 px or more, or [] for whole images')
    need(data['features'] >= 6, 'data.features', 'must be 6 or more')
    need(data['border'] >= 0, 'data.border', 'must not be negative')
    need(data['sides'] in ('both', 'target'), 'data.sides', 'must be both or target')
    need(data['variants'] >= 0, 'data.variants', 'must not be negative')
    need(0 < data['validation_share'] < 1, 'data.validation_share', 'must lie between 0 and 1')
    need(data['appearance'], 'data.appearance', 'must have an entry; ["clean"] for no change')
    for text in data['appearance']:
        for part in text.split('+'):
            try:
                appearance.parse(part)
            except ValueError as e:
                raise InputError(f'data.appearance: {e}') from None
    need(loss['kind'] in ('each_level', 'unrolled'), 'loss.kind', 'must be each_level or unrolled')
    need(loss['grid'] >= 1, 'loss.grid', 'must be 1 or more')
    need(loss['iterations'] >= 1, 'loss.iterations', 'must be 1 or more')
    need(loss['step_bound'] >= 0, 'loss.step_bound', 'must not be negative')
    need(recipe['optimizer']['kind'] in ('adam', 'sgd'), 'optimizer.kind', 'must be adam or sgd')
    need(recipe['optimizer']['learning_rate'] > 0, 'optimizer.learning_rate', 'must be positive')
    need(recipe['schedule']['kind'] in ('cosine', 'step'), 'schedule.kind', 'must be cosine or step')
    need(recipe['schedule']['epochs'] >= 0, 'schedule.epochs', 'must not be negative')
    need(recipe['schedule']['steps'] >= 1, 'schedule.steps', 'must be 1 or more')
    need(recipe['validation']['every'] >= 1, 'validation.every', 'must be 1 or more')
    need(recipe['validation']['epochs'] >= 0, 'validation.epochs', 'must not be negative')
    need(recipe['validation']['pairs'] >= 1, 'validation.pairs', 'must be 1 or more')
    need(0 <= recipe['export']['carry'] <= 1, 'export.carry', 'must lie in 0 to 1')
    need(1 <= recipe['export']['iterations'] <= 100, 'export.iterations', 'must lie in 1 to 100')


def difference(old, new, where=''):
    """The first key in which two recipes differ, with both values, or None."""
    for key, value in old.items():
        if isinstance(value, dict):
            inner = difference(value, new.get(key, {}), where + key + '.')
            if inner:
                return inner
        elif new.get(key) != value:
            return f'{where}{key} was {value!r}, now {new.get(key)!r}'
    return None
