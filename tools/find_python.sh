#!/usr/bin/env bash
# Prints the first Python that can build the environment. Usage: tools/find_python.sh VERSION...
# It must be of that version and have its headers, which the interfaces are compiled against.
# Fails without output when there is none.
set -uo pipefail

# Prints what may be a Python of version $1; a version manager's shim may stand in the path and still
# run nothing, so the managers' own folders follow.
candidates() {
  type -ap "python$1"
  local folder
  for folder in "${PYENV_ROOT:-$HOME/.pyenv}/versions" "${ASDF_DATA_DIR:-$HOME/.asdf}/installs/python" \
                "${MISE_DATA_DIR:-$HOME/.local/share/mise}/installs/python"; do
    compgen -G "$folder/$1*/bin/python$1"
  done
  if [ -x .uv/bin/uv ]; then
    UV_PYTHON_DOWNLOADS=never .uv/bin/uv python find --system "$1" 2>/dev/null
  fi
}

usable() {
  "$1" - "$2" 2>/dev/null <<'PYTHON'
import os, sys, sysconfig
wanted = "%d.%d" % sys.version_info[:2] == sys.argv[1]
headers = os.path.exists(os.path.join(sysconfig.get_paths()["include"], "Python.h"))
sys.exit(not (wanted and headers))
PYTHON
}

for version in "$@"; do
  while read -r python; do
    if usable "$python" "$version"; then
      echo "$python"
      exit 0
    fi
  done < <(candidates "$version")
done
exit 1
