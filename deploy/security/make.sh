#!/usr/bin/env bash
# Makes certificates and permissions of DDS Security, one folder per role. See --help and docs/cluster.md 5.
set -uo pipefail
umask 077

usage() {
  cat <<'TEXT'
usage: deploy/security/make.sh [--out DIR] [--role ROLE]... [--host NAME]... [--run NAME] [--renew] [--revoke FOLDER]...

Makes the files that --security-dir (OMENTUM_SECURITY_DIR) of every program wants, one folder per role:
identity_ca.pem certificate.pem key.pem crl.pem permissions_ca.pem governance.p7s permissions.p7s
What is there already is kept, the CAs always. Copy to a host only the folders of its roles, never DIR/ca.
  --out DIR         default: deploy/security/out
  --role ROLE       learner, worker, gateway, mismatch, tool (reads everything) or operator (a tool that also
                    commands); may be repeated; default: all six
  --host NAME       certificates of this host alone, in folders ROLE-NAME; may be repeated
  --run NAME        permissions for this run only; default: any run
  --days N          end of the certificates, days from now (default 365)
  --from TIME       begin and end instead, as date -d reads them (default: 5 minutes ago,
  --until TIME      for hosts whose clocks differ, and --days from now)
  --renew           new certificates for the keys that are there, file by file: programs may go on meanwhile
  --revoke FOLDER   put the certificate of DIR/FOLDER on the list of revoked ones; may be repeated. Copy crl.pem to
                    every host; programs read it when they start. The role gets a new key the next time it is made
  --group GROUP     members may read the folders of the roles, for containers whose user is another: 10001 for
                    the images of docker/
Exit codes: 0 done, 1 failed, 2 wrong option.
TEXT
}
wrong() {
  echo "make.sh: $1 (see --help)" >&2
  exit 2
}
fail() {
  echo "make.sh: $1" >&2
  exit 1
}

out=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)/out
roles=() hosts=() revoked=() run='' days=365 from='5 minutes ago' until='' renew=0 group=''
name_pattern='^[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}$'
while (($#)); do
  case $1 in
    --out | --role | --host | --run | --days | --from | --until | --revoke | --group)
      [[ -n ${2-} ]] || wrong "$1 needs a value" ;;&
    --out) out=$2; shift ;;
    --role)
      [[ $2 =~ ^(learner|worker|gateway|mismatch|tool|operator)$ ]] ||
        wrong "--role $2: learner, worker, gateway, mismatch, tool or operator"
      roles+=("$2"); shift ;;
    --host) [[ $2 =~ $name_pattern ]] || wrong "--host $2: letters, digits, _ . -"; hosts+=("$2"); shift ;;
    --run) [[ $2 =~ $name_pattern ]] || wrong "--run $2: letters, digits, _ . -"; run=$2; shift ;;
    --days) [[ $2 =~ ^[1-9][0-9]{0,3}$ ]] || wrong "--days $2: 1 to 9999"; days=$2; shift ;;
    --from) from=$2; shift ;;
    --until) until=$2; shift ;;
    --renew) renew=1 ;;
    --revoke) [[ $2 =~ $name_pattern ]] || wrong "--revoke $2: a folder of --out"; revoked+=("$2"); shift ;;
    --group) group=$2; shift ;;
    -h | --help) usage; exit 0 ;;
    *) wrong "unknown option $1" ;;
  esac
  shift
done
begin_s=$(date -d "$from" +%s 2>/dev/null) || wrong "--from $from: not a time that date -d knows"
end_s=$(date -d "${until:-$days days}" +%s 2>/dev/null) || wrong "--until $until: not a time that date -d knows"
((begin_s < end_s)) || wrong "--until ${until:-$days days} is before --from $from"
((${#roles[@]})) || roles=(learner worker gateway mismatch tool operator)
command -v openssl >/dev/null || fail "openssl is missing: apt-get install openssl"

# The table of docs/cluster.md 5, without "omentum/". Only the learner speaks as one; in a hub it also passes on what
# workers say, for tools.
declare -A writes=(
  [learner]="policy/weights rollout/task rollout/segment learner/status worker/status episode/summary run/manifest
             sim/frame robot/state control/command control/reply"
  [worker]="rollout/segment worker/status sim/frame control/reply simulation/result"
  [gateway]="robot/state rollout/segment episode/summary control/reply"
  [mismatch]="simulation/task"
  [tool]=""
  [operator]="control/command"
)
declare -A reads=(
  [learner]="rollout/segment worker/status learner/status robot/state run/manifest sim/frame control/command control/reply"
  [worker]="policy/weights rollout/task learner/status run/manifest control/command simulation/task"
  [gateway]="policy/weights learner/status run/manifest control/command"
  [mismatch]="worker/status simulation/result"
  [tool]="*"
  [operator]="*"
)
readonly files=(identity_ca.pem certificate.pem key.pem crl.pem permissions_ca.pem governance.p7s permissions.p7s)

scratch=$(mktemp -d) || exit 1
trap 'rm -rf "$scratch"' EXIT
export OMENTUM_CA=$out/ca/identity  # read by ca.cnf
# Runs openssl, whose own words are worth reading only where it fails.
openssl_quietly() {
  openssl "$@" 2>"$scratch/said" || fail "openssl $1 failed: $(tail -n 1 "$scratch/said")"
}
asn1_time() { date -u -d "@$1" +%Y%m%d%H%M%SZ; }
xml_time() { date -u -d "@$1" +%Y-%m-%dT%H:%M:%SZ; }
make_key() { openssl_quietly genpkey -algorithm EC -pkeyopt ec_paramgen_curve:P-256 -out "$1"; }
# Signs a request with the authority in ca/$1; $2... = options of openssl ca.
certify() {
  local authority=$1
  shift
  OMENTUM_CA=$out/ca/$authority
  openssl_quietly ca -batch -notext -config "$scratch/ca.cnf" "$@"
}
cat >"$scratch/ca.cnf" <<'TEXT'
[ca]
default_ca = authority
[authority]
database = $ENV::OMENTUM_CA/index.txt
serial = $ENV::OMENTUM_CA/serial
crlnumber = $ENV::OMENTUM_CA/crlnumber
new_certs_dir = $ENV::OMENTUM_CA/certificates
certificate = $ENV::OMENTUM_CA/ca.pem
private_key = $ENV::OMENTUM_CA/ca.key
default_md = sha256
default_crl_days = 3650
policy = names
x509_extensions = of_role
unique_subject = no
[names]
organizationName = supplied
commonName = supplied
[of_role]
basicConstraints = critical, CA:FALSE
keyUsage = critical, digitalSignature
[of_authority]
basicConstraints = critical, CA:TRUE
keyUsage = critical, keyCertSign, cRLSign, digitalSignature
[req]
distinguished_name = nothing
[nothing]
TEXT

make_authority() {  # $1 = identity or permissions
  local folder=$out/ca/$1
  if [[ -e $folder/ca.pem && -e $folder/ca.key ]]; then return; fi
  [[ ! -e $folder ]] || fail "$folder is not complete: put ca.pem and ca.key back, or remove all of $out and begin anew"
  rm -rf "$folder.new"
  mkdir -p "$folder.new/certificates"
  : >"$folder.new/index.txt"
  echo 01 >"$folder.new/crlnumber"
  make_key "$folder.new/ca.key"
  openssl_quietly req -new -config "$scratch/ca.cnf" -key "$folder.new/ca.key" -subj "/O=omentum/CN=$1 CA" \
    -out "$scratch/request"
  certify "$1.new" -selfsign -create_serial -in "$scratch/request" -out "$folder.new/ca.pem" -extensions of_authority \
    -startdate "$(asn1_time $((now - 86400)))" -enddate "$(asn1_time $((now + 10 * 366 * 86400)))"
  mv -T "$folder.new" "$folder" || exit 1
  echo "made the $1 CA, valid for ten years"
}

sign() {  # $1 = XML, $2 = signed file
  openssl_quietly smime -sign -text -in "$1" -out "$2" -signer "$out/ca/permissions/ca.pem" \
    -inkey "$out/ca/permissions/ca.key"
}
governance() {
  cat <<'TEXT'
<?xml version="1.0" encoding="utf-8"?>
<dds>
  <domain_access_rules>
    <domain_rule>
      <domains><id_range><min>0</min><max>230</max></id_range></domains>
      <allow_unauthenticated_participants>false</allow_unauthenticated_participants>
      <enable_join_access_control>true</enable_join_access_control>
      <discovery_protection_kind>ENCRYPT</discovery_protection_kind>
      <liveliness_protection_kind>ENCRYPT</liveliness_protection_kind>
      <rtps_protection_kind>SIGN</rtps_protection_kind>
      <topic_access_rules>
        <topic_rule>
          <topic_expression>*</topic_expression>
          <enable_discovery_protection>true</enable_discovery_protection>
          <enable_liveliness_protection>true</enable_liveliness_protection>
          <enable_read_access_control>true</enable_read_access_control>
          <enable_write_access_control>true</enable_write_access_control>
          <metadata_protection_kind>NONE</metadata_protection_kind>
          <data_protection_kind>ENCRYPT</data_protection_kind>
        </topic_rule>
      </topic_access_rules>
    </domain_rule>
  </domain_access_rules>
</dds>
TEXT
}
# What a role may do with some topics. A program writes into "" and <run> at once and is refused where one of them is
# missing here; tasks go into <run>/w<id>.
topic_rule() {  # $1 = publish or subscribe, $2... = topics
  local kind=$1 topic partition partitions=('' '*')
  shift
  (($#)) || return
  [[ -z $run ]] || partitions=('' "$run" "$run/*")
  echo "        <$kind>"
  echo "          <topics>"
  for topic in "$@"; do echo "            <topic>omentum/$topic</topic>"; done
  echo "          </topics>"
  echo "          <partitions>"
  for partition in "${partitions[@]}"; do echo "            <partition>$partition</partition>"; done
  echo "          </partitions>"
  echo "        </$kind>"
}
permissions() {  # $1 = role, $2 = folder
  local topics
  cat <<TEXT
<?xml version="1.0" encoding="utf-8"?>
<dds>
  <permissions>
    <grant name="$1">
      <subject_name>CN=$2,O=omentum</subject_name>
      <validity>
        <not_before>$(xml_time "$begin_s")</not_before>
        <not_after>$(xml_time "$end_s")</not_after>
      </validity>
      <allow_rule>
        <domains><id_range><min>0</min><max>230</max></id_range></domains>
$(read -r -d '' -a topics <<<"${writes[$1]}"; topic_rule publish "${topics[@]}")
$(read -r -d '' -a topics <<<"${reads[$1]}"; topic_rule subscribe "${topics[@]}")
      </allow_rule>
      <default>DENY</default>
    </grant>
  </permissions>
</dds>
TEXT
}

# Whether DIR/$1 holds every file and a certificate that was not revoked.
is_complete() {
  local file
  for file in "${files[@]}"; do [[ -s $out/$1/$file ]] || return 1; done
  ! is_revoked "$1"
}
serial_of() { openssl x509 -in "$out/$1/certificate.pem" -noout -serial | cut -d= -f2; }
is_revoked() {
  [[ -s $out/$1/certificate.pem ]] && awk -F'\t' -v serial="$(serial_of "$1")" \
    '$1 == "R" && $4 == serial { found = 1 } END { exit !found }' "$out/ca/identity/index.txt"
}
# Puts a file into a folder in one step: a program that starts meanwhile reads the old one or the new one.
place() {  # $1 = source, $2 = folder, $3 = name
  local mode=600
  [[ -z $group ]] || mode=640
  install -m "$mode" ${group:+-g "$group"} "$1" "$out/$2/.$3.new" && mv -T "$out/$2/.$3.new" "$out/$2/$3" ||
    fail "cannot write $out/$2/$3"
}

make_role() {  # $1 = role, $2 = folder
  local key=$out/$2/key.pem mode=700
  [[ -z $group ]] || mode=750
  if is_complete "$2" && ((!renew)); then
    echo "kept $2, $(openssl x509 -in "$out/$2/certificate.pem" -noout -enddate | sed 's/.*=/valid until /'); --renew makes it anew"
  else
    if is_revoked "$2"; then mv -T "$out/$2" "$out/ca/revoked-$2-$(serial_of "$2")" || exit 1; fi
    install -d -m "$mode" ${group:+-g "$group"} "$out/$2" || exit 1
    [[ -s $key ]] || { make_key "$scratch/key" && place "$scratch/key" "$2" key.pem; }
    openssl_quietly req -new -config "$scratch/ca.cnf" -key "$key" -subj "/O=omentum/CN=$2" -out "$scratch/request"
    certify identity -in "$scratch/request" -out "$scratch/certificate" -startdate "$(asn1_time "$begin_s")" \
      -enddate "$(asn1_time "$end_s")"
    permissions "$1" "$2" >"$scratch/permissions.xml"
    sign "$scratch/permissions.xml" "$scratch/permissions"
    # The key stays, so every mixture of old and new files is valid.
    place "$scratch/certificate" "$2" certificate.pem
    place "$scratch/permissions" "$2" permissions.p7s
    place "$out/ca/identity/ca.pem" "$2" identity_ca.pem
    place "$out/ca/permissions/ca.pem" "$2" permissions_ca.pem
    place "$out/ca/governance.p7s" "$2" governance.p7s
    place "$out/ca/crl.pem" "$2" crl.pem
    echo "made $2, valid from $(xml_time "$begin_s") until $(xml_time "$end_s")${run:+, for run $run}"
  fi
  # Also what was kept, for a group that was named later.
  [[ -z $group ]] || { chgrp -R "$group" "$out/$2" && chmod 750 "$out/$2" && chmod 640 "$out/$2"/*; } ||
    fail "cannot give $out/$2 to group $group"
}

[[ -z $group ]] || chgrp "$group" "$scratch" 2>/dev/null || fail "--group $group: no such group, or not one of yours"
mkdir -p "$out/ca" || exit 1
[[ -z $group ]] || { chgrp "$group" "$out" && chmod g+x "$out"; } || exit 1
exec {lock}>"$out/ca/lock"
flock "$lock"
now=$(date +%s)
make_authority identity
make_authority permissions
if [[ ! -s $out/ca/governance.p7s ]]; then
  governance >"$scratch/governance.xml"
  sign "$scratch/governance.xml" "$scratch/governance"
  mv "$scratch/governance" "$out/ca/governance.p7s" || exit 1
fi
for folder in "${revoked[@]}"; do
  [[ -s $out/$folder/certificate.pem ]] || fail "--revoke $folder: there is no $out/$folder/certificate.pem"
  # Renewed ones have the same key.
  for serial in $(awk -F'\t' -v name="/O=omentum/CN=$folder" '$1 == "V" && $6 == name { print $4 }' \
    "$out/ca/identity/index.txt"); do
    certify identity -revoke "$out/ca/identity/certificates/$serial.pem"
  done
done
if ((${#revoked[@]})) || [[ ! -s $out/ca/crl.pem ]]; then
  # It has to outlive the authority: an old list would be refused, and the certificates with it.
  certify identity -gencrl -out "$scratch/crl"
  mv "$scratch/crl" "$out/ca/crl.pem" || exit 1
  for folder in "$out"/*/; do
    folder=$(basename "$folder")
    [[ $folder == ca ]] || place "$out/ca/crl.pem" "$folder" crl.pem
  done
fi
if ((${#revoked[@]})); then
  echo "revoked ${revoked[*]}; copy crl.pem to every host and start the programs anew"
  exit 0
fi
for role in "${roles[@]}"; do
  if ((${#hosts[@]} == 0)); then make_role "$role" "$role"; fi
  for host in "${hosts[@]}"; do make_role "$role" "$role-$host"; done
done
