"""Files that are whole or not there."""
import os

from recipe import InputError


def write_whole(path, write):
    """write(path of a temporary file), then a rename."""
    temporary = path + '.tmp'
    try:
        write(temporary)
        with open(temporary, 'rb') as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as e:
        raise InputError(f'{path}: {e.strerror}; the previous file is unchanged') from None


def write_text(path, text):
    def write(temporary):
        with open(temporary, 'w', encoding='utf-8') as file:
            file.write(text)
    write_whole(path, write)
