"""Model files: exact to the bit, whole or not at all, and nothing else is read."""

import copy
import hashlib
import json
import math
import os
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load, save

from jink.intent import model_file
from jink.intent.laws import Birth, Law, Phase
from jink.intent.model import Intent, IntentModel
from jink.intent.model_file import MODEL_FILE, load_model, save_model


def plane():
    """Numbers that decimal text would round, a template, mirrored births, a weave, learned noise."""
    turn = Phase(
        Law(2, turn_mean=0.1, turn_rate=1 / 3, turn_noise=1e-3 / 7, wobble=math.pi),
        (Birth(1 / 3, 0.0, 0.01, 0.1, 0.05), Birth(2 / 3, -0.02, 0.01, 0.3, 5e-324)),
        mirrored=True,
        duration=4 / 3,
    )
    weave = Phase(Law(2, turn_noise=1e-5, swing=(2 / 3, 0.1)), (Birth(swing_sd=0.3),))
    intents = (
        Intent("straight", (Phase(Law(2, growth_mean=-0.0, wobble=0.1)),), renewal=0.05),
        Intent("hook", (turn, Phase(Law(2)), turn)),
        Intent("wéave ✓", (weave,)),
    )
    rates = ((-0.3, 0.1, 0.2), (1 / 7, -1 / 7, 0.0), (0.0, 1e-300, -1e-300))
    about = {"seed": 3, "versions": {"jink": "0.1"}, "curve": [[1, -3.25, None], [2, -3.0, 0.1]], "resolvable": True}
    return IntentModel(2, intents, rates, (0.2, 0.3, 0.5), (1.5, 2.5), 12.3, about)


def space():
    law = Law(3, growth_rate=0.2, growth_noise=1e-4, turn_rate=0.5, turn_noise=1e-3, wobble=0.3)
    return IntentModel(3, (Intent("any", (Phase(law, (Birth(turn_sd=0.2),)),)),))


@pytest.fixture
def folder(tmp_path):
    return save_model(plane(), tmp_path / "model")


def weights_of(folder):
    (path,) = folder.glob("weights-*.safetensors")
    return path


def put_weights(folder, content):
    """Other weights, with the JSON that vouches for them: what a careful attacker would write."""
    weights_of(folder).unlink()
    digest = hashlib.sha256(content).hexdigest()
    (folder / f"weights-{digest[:16]}.safetensors").write_bytes(content)
    change(folder, weights=digest)


def change(folder, **values):
    document = json.loads((folder / MODEL_FILE).read_text())
    (folder / MODEL_FILE).write_text(json.dumps({**document, **values}))


def put_tensor(folder, name, value):
    tensors = {key: np.array(item) for key, item in load(weights_of(folder).read_bytes()).items()}
    if value is None:
        tensors.pop(name)
    else:
        tensors[name] = value
    put_weights(folder, save(tensors))


def refused(folder, *words):
    with pytest.raises(ValueError) as caught:
        load_model(folder)
    text = str(caught.value)
    assert text.startswith("load_model: ") and text.count("\n") == 0 and len(text) < 700, text
    assert text.rstrip().endswith(".")
    for word in words:
        assert word in text, text


def bits(model):
    def walk(value):
        if isinstance(value, float):
            return struct.pack("<d", value)
        if isinstance(value, tuple):
            return tuple(walk(item) for item in value)
        return value

    found = [walk((model.axes, model.generator, model.initial, model.noise_sd, model.speed))]
    for intent in model.intents:
        for phase in intent.phases:
            births = tuple(tuple(vars(birth).values()) for birth in phase.births)
            laws = tuple(vars(phase.law).values())
            found.append(walk((intent.name, float(intent.renewal), phase.mirrored, phase.duration, laws, births)))
    return found


@pytest.mark.parametrize("make", [plane, space])
def test_round_trip_is_exact_to_the_bit(make, tmp_path):
    model = make()
    again = load_model(save_model(model, tmp_path / "m"))
    assert again == model and bits(again) == bits(model) and again.about == model.about
    assert math.copysign(1.0, plane().intents[0].phases[0].law.growth_mean) == -1.0  # -0.0 is one of the bits
    names = sorted(path.name for path in (tmp_path / "m").iterdir())
    assert names[0] == MODEL_FILE and len(names) == 2
    before = {path.name: path.read_bytes() for path in (tmp_path / "m").iterdir()}
    save_model(again, tmp_path / "m")
    assert {path.name: path.read_bytes() for path in (tmp_path / "m").iterdir()} == before
    assert load_model(tmp_path / "m" / MODEL_FILE) == model


def test_a_loaded_bank_runs_without_torch(folder):
    code = (
        "import sys\n"
        "class NoTorch:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name.split('.')[0] == 'torch': raise ImportError(name)\n"
        "sys.meta_path.insert(0, NoTorch())\n"
        "import numpy as np\n"
        "from jink.intent.model_file import load_model\n"
        f"model = load_model({str(folder)!r})\n"
        "found = model.estimator().run(np.cumsum(np.ones((6, 2)), axis=0), np.arange(6.0))\n"
        "assert np.isfinite(found.position).all() and found.mode_probs.shape[-1] == len(model.modes)\n"
    )
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


# Writing.


def test_a_new_model_replaces_the_old_one_and_nothing_else(folder):
    (folder / "README.md").write_text("mine")
    (folder / "weights-notes.safetensors").write_text("also mine")
    save_model(space(), folder)
    assert load_model(folder) == space()
    assert len(list(folder.iterdir())) == 4


def test_a_kill_between_two_renames_leaves_a_whole_model(folder, monkeypatch):
    replace, left = Path.replace, [0]

    def die(self, target):
        if left[0] == 0:
            raise KeyboardInterrupt
        left[0] -= 1
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", die)
    for renames in (0, 1):
        left[0] = renames
        with pytest.raises(KeyboardInterrupt):
            save_model(space(), folder)
        assert load_model(folder) == plane()
        assert not list(folder.glob(".*"))
    left[0] = 2
    save_model(space(), folder)
    assert load_model(folder) == space() and len(list(folder.iterdir())) == 2


@pytest.mark.parametrize(
    "about",
    [{"when": object()}, {"loss": math.nan}, {"bell": "\x1b[31m"}, {"long": "x" * 3000}, {1: "a"}, {"big": 2**70}],
    ids=("object", "nan", "control character", "too long", "number as key", "too large"),
)
def test_what_could_not_be_read_is_not_written(tmp_path, about):
    with pytest.raises(ValueError, match="must"):
        save_model(plane().with_(about=about), tmp_path / "m")
    assert not (tmp_path / "m").exists()


def test_names_are_kept_or_refused(tmp_path):
    base = plane()
    with pytest.raises(ValueError, match="printable text"):
        save_model(base.with_(intents=(Intent("a\nb", base.intents[0].phases), *base.intents[1:])), tmp_path / "m")


# The weights.


class Malicious:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (Path.touch, (self.path,))


@pytest.mark.parametrize("vouched", [False, True])
def test_a_pickle_is_not_opened(folder, tmp_path, vouched):
    trap = tmp_path / "trap"
    content = __import__("pickle").dumps(Malicious(trap))
    if vouched:
        put_weights(folder, content)
        refused(folder, "be safetensors, with a header inside its", "weights-")
    else:
        weights_of(folder).write_bytes(content)
        refused(folder, "SHA-256", "Copy both files again")
    (folder / MODEL_FILE).write_bytes(content)
    refused(folder, MODEL_FILE, "JSON text in UTF-8")
    assert not trap.exists()


@pytest.mark.parametrize("kept", [0, 5, 8, 60, -8, -1])
def test_a_truncated_file(folder, kept):
    content = weights_of(folder).read_bytes()
    weights_of(folder).write_bytes(content[:kept])
    refused(folder, "SHA-256")
    put_weights(folder, content[:kept])
    refused(folder, "weights-", "Save the model again")


@pytest.mark.parametrize("cut", [0, 1, 40, -3])
def test_a_truncated_json(folder, cut):
    (folder / MODEL_FILE).write_bytes((folder / MODEL_FILE).read_bytes()[:cut])
    refused(folder, "JSON text in UTF-8")


def test_appended_bytes(folder):
    put_weights(folder, weights_of(folder).read_bytes() + b"\0" * 8)
    refused(folder, "complete safetensors file")


def test_a_header_that_claims_ten_gigabytes(folder):
    content = weights_of(folder).read_bytes()
    put_weights(folder, struct.pack("<Q", 10 * 2**30) + content[8:])
    refused(folder, "with a header inside its", f"one of {10 * 2**30} bytes")


def header_of(content):
    length = int.from_bytes(content[:8], "little")
    return json.loads(content[8 : 8 + length]), content[8 + length :]


def with_header(header, body):
    text = json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + body


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda h: h["laws"].update(dtype="F32"), ("hold laws as float64", "F32")),
        (lambda h: h["laws"].update(dtype="BF16"), ("hold laws as float64",)),
        (lambda h: h["laws"].update(dtype=[]), ("hold laws as float64",)),
        (lambda h: h["laws"].update(shape=[10**9, 10]), ("hold laws with shape [5, 10]",)),
        (lambda h: h["laws"].update(shape=[10, 5]), ("hold laws with shape [5, 10]",)),
        (lambda h: h["laws"].update(data_offsets=[0, 10**12]), ("complete safetensors file",)),
        (lambda h: h["laws"].update(data_offsets=h["births"]["data_offsets"]), ("complete safetensors file",)),
        (lambda h: h["laws"].update(data_offsets=[-8, 8]), ("complete safetensors file",)),
        (lambda h: h["laws"].update(more=1), ("describe laws by dtype, shape and data_offsets",)),
        (lambda h: h.update(laws=3), ("describe laws by dtype",)),
        (lambda h: h.update(__metadata__={"a": "b"}), ("unknown '__metadata__'",)),
        (lambda h: h.update(extra=h["laws"]), ("unknown 'extra'",)),
    ],
)
def test_a_forged_header(folder, edit, words):
    header, body = header_of(weights_of(folder).read_bytes())
    edit(header)
    put_weights(folder, with_header(header, body))
    refused(folder, *words)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("laws", np.ones((5, 9)), ("hold laws with shape [5, 10]", "[5, 9]")),
        ("laws", np.ones((6, 10)), ("hold laws with shape [5, 10]",)),
        ("generator", np.zeros(9), ("hold generator with shape [3, 3]", "[9]")),
        ("initial", np.full(3, np.nan), ("hold finite numbers in initial", "nan")),
        ("births", np.full((7, 6), np.inf), ("hold finite numbers in births", "inf")),
        ("speed", np.ones(1, dtype=np.float32), ("hold speed as float64",)),
        ("noise_sd", None, ("no 'noise_sd'",)),
        ("velocity", np.ones(2), ("unknown 'velocity'",)),
        # Numbers that are no model: the sentence of the model, with the file before it.
        ("speed", -np.ones(1), ("IntentModel: speed must be > 0",)),
        ("initial", np.ones(3), ("IntentModel: initial must be 3 probabilities",)),
        ("generator", np.eye(3), ("IntentModel: generator must have",)),
        ("births", np.full((7, 6), 0.5), ("Phase: births must have weights that sum to 1",)),
        ("laws", -np.ones((5, 10)), ("Law: growth_rate must be",)),
        ("noise_sd", np.zeros(2), ("IntentModel: noise_sd must be > 0",)),
        ("renewal", -np.ones(3), ("Intent: renewal must be >= 0",)),
    ],
)
def test_wrong_tensors(folder, name, value, words):
    if name == "births" and value is not None:
        count = sum(len(p.births) for i in plane().intents for p in i.phases)
        value = np.full((count, 6), value.flat[0])
    put_tensor(folder, name, value)
    refused(folder, "weights-", *words)


def test_every_flipped_byte_is_seen(folder):
    content = weights_of(folder).read_bytes()
    for place in range(0, len(content), 37):
        broken = bytearray(content)
        broken[place] ^= 0x10
        weights_of(folder).write_bytes(bytes(broken))
        refused(folder, "SHA-256")


# The JSON.


def deep(levels):
    return json.loads("[" * levels + "]" * levels)


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda d: d.update(version=3), ("version 1 or 2", "3", "Use the Jink that wrote it")),
        (lambda d: d.update(version=True), ("version 1",)),
        (lambda d: d.update(version=1.0), ("version 1",)),
        (lambda d: d.update(format="other"), ("format 'jink intents'",)),
        (lambda d: d.pop("version"), ("version 1",)),
        (lambda d: d.update(more=1), ("unknown 'more'",)),
        (lambda d: d.pop("about"), ("no 'about'",)),
        (lambda d: d.update(axes=4), ("axes 2 or 3", "4")),
        (lambda d: d.update(axes="2"), ("axes 2 or 3",)),
        (lambda d: d.update(axes=3), ("hold noise_sd with shape [3]",)),
        (lambda d: d.update(axes=2.0), ("axes 2 or 3",)),
        (lambda d: d.update(learned_noise=1), ("learned_noise true or false",)),
        (lambda d: d.update(learned_noise=False), ("unknown 'noise_sd'",)),
        (lambda d: d.update(weights="../../etc/passwd"), ("64 hexadecimal digits",)),
        (lambda d: d.update(weights=["a"]), ("64 hexadecimal digits",)),
        (lambda d: d.update(about=[]), ("about, an object",)),
        (lambda d: d.update(about={"a": deep(12)}), ("at most 10 deep",)),
        (lambda d: d.update(about={"a": "x" * 3000}), ("printable text",)),
        (lambda d: d.update(about={"a\x1b[2J": 1}), ("printable text",)),
        (lambda d: d.update(about={"a": 10**30}), ("63 bits",)),
        (lambda d: d.update(intents={}), ("intents, a list",)),
        (lambda d: d.update(intents=[]), ("a list of 1 to 64",)),
        (lambda d: d["intents"][0].update(name=""), ("1 to 100 letters",)),
        (lambda d: d["intents"][0].update(name=5), ("1 to 100 letters",)),
        (lambda d: d["intents"][0].update(name="hook"), ("distinct names",)),
        (lambda d: d["intents"][0].update(law="exec"), ("keys of an intent", "unknown 'law'")),
        (lambda d: d["intents"].append(3), ("describe an intent by an object",)),
        (lambda d: d["intents"][0].update(phases=[]), ("1 to 16 phases",)),
        (lambda d: d["intents"][0]["phases"][0].update(births=0), ("1 to 16 births",)),
        (lambda d: d["intents"][0]["phases"][0].update(births=True), ("1 to 16 births",)),
        (lambda d: d["intents"][0]["phases"][0].update(births=10**9), ("1 to 16 births",)),
        (lambda d: d["intents"][0]["phases"][0].update(births=2), ("hold births with shape",)),
        (lambda d: d["intents"][0]["phases"][0].update(mirrored="no"), ("mirrored true or false",)),
        (lambda d: d["intents"][0]["phases"][0].pop("mirrored"), ("keys of a phase", "no 'mirrored'")),
        (lambda d: d["intents"][0].update(phases=[{"births": 16, "mirrored": True}] * 16 * 2), ("1 to 16 phases",)),
        (
            lambda d: [i.update(phases=[{"births": 16, "mirrored": True}] * 16) for i in d["intents"]],
            ("at most 512 modes", "1536"),
        ),
    ],
)
def test_wrong_json(folder, edit, words):
    document = json.loads((folder / MODEL_FILE).read_text())
    before = copy.deepcopy(document)
    edit(document)
    assert document != before or repr(document) != repr(before)
    (folder / MODEL_FILE).write_text(json.dumps(document))
    refused(folder, *words)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"[" * 100_000, ("at most 10 deep",)),
        (b'{"a":' * 50_000 + b"1" + b"}" * 50_000, ("at most 10 deep",)),
        (b'{"a": "[[[[[[[[[[[[[[[["}', ("version 1",)),
        (b'{"a": "\\"[[[[[[[[[[[[[[[["}', ("version 1",)),
        (b'"' + b'\\"' * 500_000, ("JSON text",)),
        (b'{"version": 1, "version": 1}', ("the key 'version' twice",)),
        (b'{"version": NaN}', ("the number NaN",)),
        (b'{"version": 1e999}', ("finite numbers",)),
        (b'{"version": ' + b"9" * 5000 + b"}", ("thousands of digits",)),
        (b"[]", ("one JSON object",)),
        (b"null", ("one JSON object",)),
        (b"\xff\xfe{}", ("JSON text in UTF-8",)),
        (b'{"a": "\\ud800"}', ("printable text",)),
        (b"", ("JSON text",)),
    ],
)
def test_hostile_json(folder, text, words):
    (folder / MODEL_FILE).write_bytes(text)
    refused(folder, MODEL_FILE, *words)


# The file system.


@pytest.mark.parametrize("which", ["json", "weights"])
def test_files_that_are_no_plain_files(folder, tmp_path, which):
    path = folder / MODEL_FILE if which == "json" else weights_of(folder)
    elsewhere = tmp_path / "elsewhere"
    path.rename(elsewhere)
    path.symlink_to(elsewhere)
    refused(folder, path.name, "be a plain file", "a link")
    path.unlink()
    path.mkdir()
    refused(folder, "be a plain file")
    path.rmdir()
    os.mkfifo(path)
    refused(folder, "be a plain file")  # and does not wait for a writer
    path.unlink()
    with path.open("wb") as file:
        file.truncate(10 * 2**30)  # takes no space where files may have holes
    refused(folder, f"be at most {2**22} bytes", f"{10 * 2**30}")
    path.unlink()
    with pytest.raises(FileNotFoundError, match="must lie in the folder of the model"):
        load_model(folder)
    elsewhere.rename(path)
    assert load_model(folder) == plane()


def test_a_folder_may_be_linked_to(folder, tmp_path):
    (tmp_path / "latest").symlink_to(folder)
    assert load_model(tmp_path / "latest") == plane()


def test_no_folder(tmp_path):
    with pytest.raises(FileNotFoundError, match="load_model: folder must be that of a model"):
        load_model(tmp_path / "nowhere")


def test_models_of_different_files_are_not_mixed(folder, tmp_path):
    other = save_model(space(), tmp_path / "other")
    weights_of(folder).write_bytes(weights_of(other).read_bytes())
    refused(folder, "SHA-256")


def test_files_of_version_1_still_load(folder):
    """They have no endings, and no word on whether they have."""
    document = json.loads((folder / MODEL_FILE).read_text())
    document["version"] = 1
    del document["known_endings"]
    (folder / MODEL_FILE).write_text(json.dumps(document))
    assert load_model(folder) == plane() and load_model(folder).endings == ()
    change(folder, known_endings=False)
    refused(folder, "unknown 'known_endings'")


def test_endings_are_kept(tmp_path):
    model = plane().with_(endings=(1 / 3, 0.0, 0.07))
    folder = save_model(model, tmp_path / "m")
    assert load_model(folder) == model != plane()
    put_tensor(folder, "endings", np.array([0.1, -0.1, 0.2]))
    refused(folder, "endings must be >= 0")
    change(folder, known_endings=1)
    refused(folder, "known_endings true or false")


def test_version_and_columns_go_together():
    """A column more or fewer is another format: then VERSION moves too."""
    assert (model_file.VERSION, len(model_file.LAW), len(model_file.BIRTH)) == (2, 10, 6)
    assert list(vars(Birth())) == list(model_file.BIRTH)
    assert list(vars(Law()))[1:8] == list(model_file.LAW[:7]) and list(vars(Law()))[8:] == ["swing"]
    assert list(vars(Phase(Law()))) == ["law", "births", "mirrored", "duration"]
    fields = ["axes", "intents", "generator", "initial", "noise_sd", "speed", "about", "endings"]
    assert list(IntentModel.__dataclass_fields__) == fields and list(Intent.__dataclass_fields__)[2:] == ["renewal"]
