"""Lines of JSON against a schema: lines.py SCHEMA FILE prints what is wrong and fails if anything is."""
import json
import pathlib
import sys

import jsonschema


def problems(schema, lines):
    """What each line has against it, by its number from 1; of a choice of kinds, what each of them says."""
    validator = jsonschema.Draft202012Validator(schema)
    found = []
    for number, line in enumerate(lines, 1):
        for error in validator.iter_errors(json.loads(line)):
            said = [e.message for e in error.context or [error]]
            found.append(f'{number}: ' + '; or '.join(s[:300] for s in said))
    return found


def main():
    schema, file = map(pathlib.Path, sys.argv[1:])
    lines = file.read_text().splitlines()
    found = problems(json.loads(schema.read_text()), lines)
    print(*(f'{file}:{problem}' for problem in found), sep='\n')
    if found or not lines:
        sys.exit(f'{file}: {len(found)} breaches of {schema} in {len(lines)} lines')


if __name__ == '__main__':
    main()
