# Runs the environment's Python in the place of this shell: `exec sh stages/python.sh -m stages.NAME ...`.
#
# DVC does not say which Python it runs, and a run may be in a temporary workspace (`dvc exp run --temp`, `--queue`) or a
# Git worktree, where no environment is. In order: PORSE_PYTHON; .venv of this folder or of the nearest one above it;
# .venv of the repository's main worktree; what PATH says (an activated environment).

# A stage ends with who started it, and would not see it end before this line (stages/__init__.py).
export PORSE_PARENT="$PPID"
# A stage draws nothing, and MuJoCo does not load where MUJOCO_GL names what is not there.
export MUJOCO_GL=disable

if [ -n "$PORSE_PYTHON" ]; then
    if ! command -v "$PORSE_PYTHON" >/dev/null 2>&1; then
        echo "Error: expected PORSE_PYTHON to name a Python, found $PORSE_PYTHON; set it to one, or unset it" >&2
        exit 1
    fi
    exec "$PORSE_PYTHON" "$@"
fi
folder=$PWD
while :; do
    if [ -x "$folder/.venv/bin/python" ]; then
        exec "$folder/.venv/bin/python" "$@"
    fi
    [ -n "$folder" ] || break
    folder=${folder%/*}
done
common=$(git rev-parse --path-format=absolute --git-common-dir 2>/dev/null)
if [ -n "$common" ] && [ -x "${common%/*}/.venv/bin/python" ]; then
    exec "${common%/*}/.venv/bin/python" "$@"
fi
if command -v python >/dev/null 2>&1; then
    exec python "$@"
fi
echo "Error: expected Python in .venv here or above, or an activated environment, found none; run make setup, or set PORSE_PYTHON" >&2
exit 1
