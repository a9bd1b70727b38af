"""Broken configurations: the line with `#!` is at fault; written as its mend says, the file is good."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["BROKEN", "NEEDS", "Broken"]

SIM = '[[backends]]\nuse = "sim"\ntenant = "alpha"\n'
KEY = '[[keys]]\nname = "ann"\nrole = "operator"\nkey = "a-long-key-of-this-test-1"\n'
CAN = '[[backends]]\nuse = "can"\ntenant = "alpha"\n[backends.buses.can0]\ninterface = "virtual"\nsimulate = true\n'
PAN = '[backends.motors.pan]\nbus = "can0"\nprofile = "cia402"\nnode = 1\nvelocity = 3.0\n'
CERT = '[[certificates]]\nname = "arm"\nrole = "viewer"\n'
JWT = '[[jwt]]\nissuer = "https://issuer.example"\n'
MAVLINK = '[[backends]]\nuse = "mavlink"\ntenant = "alpha"\n'
MUJOCO = '[[backends]]\nuse = "mujoco"\ntenant = "alpha"\n'
VDA = "[plugins.vda5050]\n"
GRPC = "[plugins.a2a.grpc]\n"
RULE = '[[roles.driver.allow]]\noperations = ["read"]\n'


NEEDS = {CAN: "can", JWT: "jwt", MAVLINK: "pymavlink", MUJOCO: "mujoco", VDA: "paho", GRPC: "grpc"}
"""Modules of extras that a text needs."""


class Broken(NamedTuple):
    """One broken file."""

    text: str
    says: str
    """A part of the message."""
    mend: str | None
    """Instead of the line at fault; `^` puts it at the top of the file. None: only another file mends it."""


BROKEN = (
    # The form of TOML
    Broken("[log]\nlevel = debug #!\n", "in quotes", 'level = "info"'),
    Broken('[log]\nlevel = "info #!\n', "close the text", 'level = "info"'),
    Broken('[log #!\nlevel = "info"\n', "close the header", "[log]"),
    Broken('name "robots" #!\n', "write key = value", 'name = "robots"'),
    Broken('name = "a"\nname = "b" #!\n', "there already", ""),
    Broken('[log]\nlevel = "info"\n[store]\n[log] #!\n', "there already", ""),
    Broken('name = "a" store = 1 #!\n', "one key = value", 'name = "a"'),
    Broken('name = "C:\\data" #!\n', "single quotes", "name = 'C:\\data'"),
    Broken("name = #!\n", "in quotes", 'name = "a"'),
    Broken("[safety]\nlease_ttl = 1,5 #!\n", "one key = value", "lease_ttl = 1.5"),
    Broken("[safety]\nguard = True #!\n", "true, false", "guard = true"),
    Broken("[safety]\nguard = yes #!\n", "true, false", "guard = true"),
    # Names of tables and keys
    Broken("[limit] #!\nmessage = 4096\n", "did you mean `limits`", "[limits]"),
    Broken("[limits]\nmesage = 4096 #!\n", "did you mean `message`", "message = 4096"),
    Broken('nmae = "a" #!\n', "did you mean `name`", 'name = "a"'),
    Broken('[log]\nlvl = "info" #!\n', "did you mean `level`", 'level = "info"'),
    Broken('[store]\npaht = "x.db" #!\n', "did you mean `path`", 'path = "x.db"'),
    Broken("[safety]\nlease_tll = 3 #!\n", "did you mean `lease_ttl`", "lease_ttl = 3"),
    Broken(KEY.replace("role =", "rol =").replace('rol = "operator"', 'rol = "operator" #!'), "did you mean `role`", 'role = "operator"'),
    Broken(SIM.replace('tenant = "alpha"', 'tennant = "alpha" #!'), "did you mean `tenant`", 'tenant = "alpha"'),
    Broken(SIM.replace('use = "sim"', 'usr = "sim" #!'), "did you mean `use`", 'use = "sim"'),
    Broken(SIM + "rat = 3 #!\n", "did you mean `rate`", "rate = 3"),
    Broken("[transports.asgi]\nprot = 8080 #!\n", "did you mean `port`", "port = 8080"),
    Broken("[transports.aggi] #!\n", "did you mean 'asgi'", "[transports.asgi]"),
    Broken("[plugins.dashbord] #!\n", "did you mean 'dashboard'", "[plugins.dashboard]"),
    Broken("[features]\nplan = true #!\n", "did you mean 'plans'", "plans = true"),
    Broken(SIM.replace('"sim"', '"sin" #!'), "did you mean 'sim'", 'use = "sim"'),
    Broken(CAN.replace("interface", "interfase").replace('"virtual"', '"virtual" #!').replace("simulate = true\n", "") + PAN, "did you mean `interface`", 'interface = "virtual"'),
    # In the wrong place
    Broken('[log]\nlevel = "info"\nanonymous = false #!\n', "above the first table", "^anonymous = false"),
    Broken('[limits]\nname = "a" #!\n', "above the first table", '^name = "a"'),
    Broken("[limits.log] #!\n", "write [log]", "[log]"),
    Broken('[backends] #!\nuse = "sim"\ntenant = "a"\n', "[[backends]]", "[[backends]]"),
    Broken('[keys] #!\nname = "ann"\nrole = "viewer"\nkey = "a-long-key-of-this-test-1"\n', "list", "[[keys]]"),
    Broken("transports = 3 #!\n", "[transports.<name>]", ""),
    Broken("[transports]\nhttp = true #!\n", "[transports.http]", "http = {}"),
    Broken("[plugins]\ndashboard = true #!\n", "[plugins.dashboard]", "dashboard = {}"),
    Broken("backends = [3] #!\n", "[[backends]]", "backends = []"),
    Broken("[[log]] #!\n", "a table", "[log]"),
    Broken("[features.jwt] #!\n", "takes no keys", ""),
    # Values
    Broken('[log]\nlevel = "inof" #!\n', 'did you mean "info"', 'level = "info"'),
    Broken('[log]\nformat = "yaml" #!\n', '"console", "json"', 'format = "json"'),
    Broken('[limits]\nmessage = "big" #!\n', "a whole number", "message = 4096"),
    Broken("[limits]\nmessage = 3 #!\n", "at least 1024", "message = 4096"),
    Broken("[limits]\nmessage = 4096.5 #!\n", "a whole number", "message = 4096"),
    Broken("[limits]\nheartbeat = 0 #!\n", "greater than 0", "heartbeat = 1"),
    Broken("[limits]\ndeadline = 99999 #!\n", "at most 3600", "deadline = 10"),
    Broken("[limits]\nsessions = true #!\n", "a whole number", "sessions = 10"),
    Broken("name = 3 #!\n", "a text", 'name = "3"'),
    Broken("name = [1] #!\n", "a text", 'name = "a"'),
    Broken('[safety]\nguard = "yes" #!\n', "true or false", "guard = true"),
    Broken("[safety]\nguard_after = 60 #!\n", "at most 10", "guard_after = 5"),
    Broken('[safety]\nlease_required = "/tenant/**" #!\n', "a list", 'lease_required = ["/tenant/**"]'),
    Broken('[safety]\nlease_required = [\n  "/tenant/**",\n  3, #!\n]\n', "a text", ""),
    Broken(SIM + 'name = "ro ver" #!\n', "letters, digits, `_`, `.`, `-`", 'name = "rover"'),
    Broken(SIM + f'name = "{"r" * 65}" #!\n', "at most 64", 'name = "rover"'),
    Broken(SIM + "rate = 5000 #!\n", "at most 1000", "rate = 50"),
    Broken(SIM.replace('"alpha"', "3 #!"), "a text", 'tenant = "alpha"'),
    Broken("[transports.asgi]\nport = 80800 #!\n", "at most 65535", "port = 8080"),
    Broken('[transports.asgi]\nport = "8080" #!\n', "a whole number", "port = 8080"),
    Broken('[tenants."a b"] #!\n', "letters, digits", "[tenants.ab]"),
    # What is missing
    Broken('[[backends]] #!\nuse = "sim"\n', "needs `tenant`", '[[backends]]\ntenant = "a"'),
    Broken('[[backends]] #!\ntenant = "a"\n', "needs `use`", '[[backends]]\nuse = "sim"'),
    Broken('[[keys]] #!\nrole = "viewer"\nkey = "a-long-key-of-this-test-1"\n', "needs `name`", '[[keys]]\nname = "a"'),
    Broken('[[roles.driver.allow]] #!\noperations = ["read"]\n', "needs `paths`", '[[roles.driver.allow]]\npaths = ["/**"]'),
    Broken(CERT.replace("[[certificates]]", "[[certificates]] #!"), "`subject` or a `san`", '[[certificates]]\nsubject = "x"'),
    Broken('[[keys]] #!\nname = "ann"\nrole = "viewer"\n', "`key` or `sha256`", '[[keys]]\nkey = "a-long-key-of-this-test-1"'),
    Broken('[[keys]] #!\nname = "ann"\nkey = "a-long-key-of-this-test-1"\n', "needs a `role`", '[[keys]]\nrole = "viewer"'),
    Broken(JWT.replace("[[jwt]]", "[[jwt]] #!"), "needs `audience`", '[[jwt]]\naudience = "a"\njwks_url = "https://issuer.example/jwks"\nrole = "viewer"'),
    # Identities
    Broken(KEY.replace('"operator"', '"operater" #!'), "did you mean 'operator'", 'role = "operator"'),
    Broken(KEY + 'tenants = ["beta"] #!\n' + SIM, "unknown tenant 'beta'", 'tenants = ["alpha"]'),
    Broken(KEY.replace("a-long-key-of-this-test-1", "short").replace('"short"', '"short" #!'), "at least 16", 'key = "a-long-key-of-this-test-1"'),
    Broken(KEY.replace('key = "a-long-key-of-this-test-1"', 'sha256 = "abc" #!'), "64 characters", f'sha256 = "{"0" * 64}"'),
    Broken(KEY + 'expires = "tomorrow" #!\n', "2027-01-31", 'expires = "2027-01-31"'),
    Broken(KEY + KEY.replace("ann", "bob").replace('test-1"', 'test-1" #!'), "the same secret", 'key = "a-long-key-of-this-test-2"'),
    Broken('[anonymous]\nrole = "viewr" #!\n', "did you mean 'viewer'", 'role = "viewer"'),
    Broken(CERT + 'san = "x.example" #!\n', "does not fit", 'san = "DNS:x.example"'),
    Broken(KEY.replace('"a-long-key-of-this-test-1"', '"${RCP_NOT_SET}" #!'), "RCP_NOT_SET, which is not set", 'key = "${RCP_NOT_SET:-a-long-key-of-this-test-1}"'),
    Broken('name = "${HOME" #!\n', "close it with `}`", 'name = "${HOME}"'),
    Broken('name = "${1ST}" #!\n', "names no variable", 'name = "first"'),
    # Rules and scopes
    Broken(RULE.replace('"read"]', '"fly"] #!') + 'paths = ["/**"]\n', '"discover"', 'operations = ["read"]'),
    Broken(RULE + 'paths = ["tenant/**"] #!\n', "begin with '/'", 'paths = ["/tenant/**"]'),
    Broken(RULE + 'paths = ["/**"]\nwhen = "value >" #!\n', "when", ""),
    Broken('[safety.groups]\ncell = ["/tenant/beta"] #!\n' + SIM, "is not in a tenant", 'cell = ["/tenant/alpha"]'),
    Broken('[roles.driver]\napprove = ["/system/plans"] #!\n', "need no approval", 'approve = ["/tenant/**"]'),
    Broken("[roles.driver]\npriority = 200 #!\n", "at most 100", "priority = 20"),
    # Robots
    Broken(SIM + SIM.replace("[[backends]]", "[[backends]] #!"), "unique `name`", '[[backends]]\nname = "other"'),
    Broken(CAN + PAN + PAN.replace("pan", "tilt").replace("node = 1", "node = 1 #!"), "already used by pan", "node = 2"),
    Broken(CAN + PAN.replace('"can0"', '"can1" #!'), "there is no bus 'can1'", 'bus = "can0"'),
    Broken(CAN + PAN.replace('"cia402"', '"cia420" #!'), "unknown 'cia420'", 'profile = "cia402"'),
    Broken(CAN.replace("simulate = true", "simulate = true #!").replace('"virtual"', '"socketcan"'), "`simulate` needs", ""),
    Broken('[transports.asgi]\nhost = "0.0.0.0" #!\n', "anonymous = false", 'host = "127.0.0.1"'),
    Broken("[features]\njwt = false #!\n" + JWT + 'audience = "a"\njwks_url = "https://issuer.example/jwks"\nrole = "viewer"\n', "uses this feature", ""),
    # Files of other editors, formats and tools
    Broken("name = \u201crobots\u201d #!\n", "straight", 'name = "robots"'),
    Broken("name\u00a0= 1 #!\n", "invisible character", 'name = "a"'),
    Broken('name = "robots"; #!\n', "no `;`", 'name = "robots"'),
    Broken("name: robots #!\n", "looks like YAML", 'name = "robots"'),
    Broken('{"name": "robots"} #!\n', "looks like JSON", 'name = "robots"'),
    Broken('[log]\r\n\tlevel\t=\t"inof"\t#!\n', 'did you mean "info"', 'level = "info"'),
    # Values of another kind
    Broken("name = 2026-01-31 #!\n", "the date 2026-01-31", 'name = "2026-01-31"'),
    Broken("[limits]\nmessage = 99999999999999999999999999 #!\n", "too large", "message = 4096"),
    Broken("[limits]\nheartbeat = inf #!\n", "at most 1000000000", "heartbeat = 1"),
    Broken("[limits]\nheartbeat = nan #!\n", "no number", "heartbeat = 1"),
    Broken(SIM + 'rate = "50" #!\n', "a number", "rate = 50"),
    Broken(SIM.replace('"alpha"', '"plant/north" #!'), "letters, digits", 'tenant = "alpha"'),
    Broken(RULE.replace('["read"]', '"read" #!') + 'paths = ["/**"]\n', "with [ ] around it", 'operations = ["read"]'),
    Broken(KEY.replace('"a-long-key-of-this-test-1"', '"${RCP_EMPTY}" #!'), "a variable or file is empty", 'key = "a-long-key-of-this-test-1"'),
    # Files and folders
    Broken('include = ["rcp.toml"] #!\n', "this file itself", ""),
    Broken('include = ["/tmp"] #!\n', "/tmp/*.toml", ""),
    Broken('include = "more.toml" #!\n', "with [ ] around it", "include = []"),
    Broken('[store]\npath = "/tmp" #!\n', "is a folder", 'path = "rcp.db"'),
    Broken('[store]\npath = "/etc/passwd/rcp.db" #!\n', "is a file", 'path = "rcp.db"'),
    Broken(KEY.replace('"a-long-key-of-this-test-1"', '"${file:absent.key}" #!'), "No such file", 'key = "a-long-key-of-this-test-1"'),
    Broken('[transports.asgi]\nport = 8443\n[transports.asgi.tls]\ncertificate = "absent.pem" #!\nkey = "absent.key"\n', "No such file", None),
    Broken(MUJOCO + 'model = "absent.xml" #!\n', "there is no file", 'model = "rover"'),
    # Addresses
    Broken('[transports.asgi]\nhost = "http://127.0.0.1" #!\n', "write host = '127.0.0.1'", 'host = "127.0.0.1"'),
    Broken('[transports.asgi]\nhost = "127.0.0.1:9000" #!\n', "and port = 9000", 'host = "127.0.0.1"'),
    Broken('[transports.asgi]\nhost = "http://localhost/rcp" #!\n', "write host = 'localhost'", 'host = "localhost"'),
    Broken('[transports.asgi]\nhost = "http://[::1]" #!\n', "write host = '::1'", 'host = "::1"'),
    Broken('[transports.asgi]\nhost = "https://[::1]:8443/rcp" #!\n', "write host = '::1' and port = 8443", 'host = "::1"'),
    Broken('[transports.asgi]\nhost = "http://[::1" #!\n', "the name or the address alone", 'host = "::1"'),
    Broken(f'{MAVLINK}links = ["upd:127.0.0.1:14550"] #!\n', "is not a link", 'links = ["udpin:127.0.0.1:14550"]'),
    Broken(f'{MAVLINK}dialect = "ardupilot" #!\n', "did you mean 'ardupilotmega'", 'dialect = "ardupilotmega"'),
    Broken(f'{MAVLINK}name = "a"\n{MAVLINK}name = "b"\nlinks = ["udpin:127.0.0.1:14550"] #!\n', "only one can open it", 'links = ["udpin:127.0.0.1:14551"]'),
    Broken(f'{MAVLINK}name = "a"\n{MAVLINK}name = "b"\nlinks = ["udpin:0.0.0.0:14550"] #!\n', "'udpin:0.0.0.0:14550' is used", 'links = ["udpin:127.0.0.2:14550"]'),
    Broken(f'{MAVLINK}name = "a"\nlinks = ["tcpin:[::]:5760"]\n{MAVLINK}name = "b"\nlinks = ["tcpin:[::1]:5760"] #!\n', "only one can open it", 'links = ["tcpin:127.0.0.1:5760"]'),
    Broken(f'{MAVLINK}name = "a"\nlinks = ["udpin:[::]:5760"]\n{MAVLINK}name = "b"\nlinks = ["udpin:0.0.0.0:5760"] #!\n', "only one can open it", 'links = ["tcpin:0.0.0.0:5760"]'),
    Broken(f'{MAVLINK}name = "a"\nlinks = ["udpin:127.0.0.1:5760"]\n{MAVLINK}name = "b"\nlinks = ["udpin:[::]:5760"] #!\n', "only one can open it", 'links = ["udpin:[::1]:5760"]'),
    Broken(f'{MAVLINK}name = "a"\nlinks = ["serial:/dev/ttyACM0"]\n{MAVLINK}name = "b"\nlinks = ["serial:/dev/ttyACM0:115200"] #!\n', "only one can open it", 'links = ["serial:/dev/ttyACM1:115200"]'),
    Broken(VDA + 'broker = "http://127.0.0.1:1883" #!\n', "mqtt://HOST:PORT", 'broker = "mqtt://127.0.0.1:1883"'),
    Broken(GRPC + "port = 8080 #!\n", "is the port of [transports.asgi]", "port = 50051"),
    Broken(f'{JWT}audience = "a"\nrole = "viewer"\njwks_url = "issuer.example/jwks" #!\n', "https URL", 'jwks_url = "https://issuer.example/jwks"'),
    # Motors
    Broken(CAN + PAN.replace("node = 1", "node = 200 #!"), "1 to 127", "node = 2"),
    Broken(CAN + PAN.replace('"cia402"', '"odrive"').replace("node = 1", "node = 64 #!"), "0 to 63", "node = 63"),
    Broken(CAN + PAN.replace("node = 1", 'node = "0x01" #!'), "a whole number", "node = 1"),
    Broken(SIM + '[plans.actions.go]\npath = "tenant/alpha/action/go" #!\n', "beginning with '/'", 'path = "/tenant/alpha/action/go"'),
)  # fmt: skip
