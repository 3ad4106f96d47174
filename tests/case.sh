#!/bin/sh
# Tests of the case runner as a program: what it refuses, what it writes, its exit status.
#
#     tests/case.sh PROGRAM FOLDER [SHARED]        works in FOLDER, which is made new
#
# Ends with `N passed, N failed, N skipped`.
case $1 in /*) program=$1 ;; *) program=$(pwd)/$1 ;; esac
folder=$2
shared=${3:-$(pwd)/../shared}
study_merge=$(cd "$(dirname "$0")/../examples/study" && pwd)/merge.sh
passed=0 failed=0 skipped=0
rm -rf "$folder" && mkdir -p "$folder/case/out" && cd "$folder/case" || exit 1

# A unit cube as one hex8, its x = 0, y = 0, z = 0 and z = 1 sides; a tet10; a surface.
mesh() { # mesh POINTS CELL_COUNT CELL_SIZES CELLS TYPES
    printf '# vtk DataFile Version 3.0\nx\nASCII\nDATASET UNSTRUCTURED_GRID\n'
    printf '%s\nCELLS %s %s\n%s\nCELL_TYPES %s\n%s\n' "$1" "$2" "$3" "$4" "$2" "$5"
}
cube='POINTS 8 double 0 0 0 1 0 0 1 1 0 0 1 0 0 0 1 1 0 1 1 1 1 0 1 1'
tet='POINTS 10 double 0 0 0 1 0 0 0 1 0 0 0 1 .5 0 0 .5 .5 0 0 .5 0 0 0 .5 .5 0 .5 0 .5 .5'
mesh "$cube" 1 9 '8 0 1 2 3 4 5 6 7' 12 >cube.vtk
{ cat cube.vtk && printf 'CELL_DATA 1\nSCALARS region int 1\nLOOKUP_TABLE default\n7\n'; } >region7.vtk
mesh "$tet" 1 11 '10 0 1 2 3 4 5 6 7 8 9' 24 >tet10.vtk
mesh "$cube" 1 4 '3 0 1 2' 5 >surface.vtk
mesh "$cube" 1 21 '20 0 1 2 3 4 5 6 7 0 1 2 3 4 5 6 7 0 1 2 3' 25 >hex20.vtk
printf '0\n3\n4\n7\n' >x0
printf '0\n1\n4\n5\n' >y0
printf '0\n1\n2\n3\n' >z0
printf '# the top\n4\n5\n\n6\n7\n' >z1
printf '0\n1\n2\n' >z0tet
echo '4 5 6 7' >top
echo '0 1 2' >side
echo '0 1 5 6' >notaface
printf '4 5 6 7\n7 6 5 4\n' >twice
: >empty
printf '0\n8\n' >range
printf '0\n1.5\n' >fraction
printf '0\n0\n' >double
printf '0 1\n' >two
printf '4 0 0 -0.1\n5 0 0 -0.1\n6 0 0 -0.1\n7 0 0 -0.1\n' >moves
printf '4 0 0 nan\n' >nan
printf '4 -1 0 0 1\n' >pushing
printf '4 0 0\n' >short
printf '\0' >binary

material='material linear E=1000 nu=0.3 density=1000'
symmetry='fix x nodes=x0
fix y nodes=y0
fix z nodes=z0'
static='solve static steps=1 tol=1e-10'

result() { # result NAME STATUS: 0 is good
    if [ "$2" = 0 ]; then
        passed=$((passed + 1))
    else
        echo "FAILED: $1"
        sed 's/^/    /' ../stdout ../stderr
        failed=$((failed + 1))
    fi
}
run() { # run NAME [ARGUMENT...]: from FOLDER, so that inputs beside the case and outputs here are told apart
    run_case=$1
    shift
    (cd .. && "$program" "case/$run_case" -p case/out/ "$@" >stdout 2>stderr)
    run_status=$?
}

# wrong NAME LINE PATTERN <<CASE: exit 2, one message about that line, nothing written
wrong() {
    cat >wrong.case
    refused "$@"
}
refused() {
    run wrong.case -o case/out/all.vtk
    [ "$run_status" = 2 ] && [ "$(wc -l <../stderr)" -eq 1 ] && [ ! -s ../stdout ] && [ -z "$(ls out)" ] &&
        grep -q "^case/wrong.case:$2: .*$3" ../stderr
    result "refuses $1" $?
    rm -f out/*
}
# In the place of one line of a good case
say() { printf '%s\n' "$@"; }
wrong_mesh() {
    say "mesh $2" "$material" "$symmetry" "$static" >wrong.case
    refused "$1" 1 "$3"
}
wrong_material() {
    say 'mesh cube.vtk' "$symmetry" "$static" "$2" >wrong.case
    refused "$1" 6 "$3"
}
wrong_line() {
    say 'mesh cube.vtk' "$material" "$symmetry" "$2" "$static" >wrong.case
    refused "$1" 6 "$3"
}
wrong_solve() {
    say 'mesh cube.vtk' "$material" "$symmetry" 'output displacement u' "$2" >wrong.case
    refused "$1" 7 "$3"
}

wrong_mesh 'a mesh that is not there' nowhere.vtk 'nowhere.vtk'
wrong_mesh 'a folder for a mesh' out 'out'
wrong_mesh 'a mesh that is none' x0 'x0'
wrong_mesh 'a surface' surface.vtk 'surface of tri3'
wrong_mesh 'a hex20 with a node twice' hex20.vtk 'used twice: 0'
wrong_mesh 'a missing word' '' 'word is missing; expected: mesh FILE'
wrong_mesh 'a word too many' 'cube.vtk cube.vtk' 'unexpected word cube.vtk'

wrong_material 'an unknown material' 'material steel E=1' "unknown material 'steel'"
wrong_material 'no material name' 'material' 'known: linear'
wrong_material 'a missing parameter' 'material svk E=1 nu=0.3' 'missing option density'
wrong_material 'parameters of two laws' 'material neo_hookean E=1 nu=0.3 C10=2 density=1' 'do not go together'
wrong_material 'an unknown parameter' 'material svk E=1 nu=0.3 density=1 G=1' 'unknown option G'
wrong_material 'a foreign parameter' 'material svk E=1 nu=0.3 density=1 steps=1' 'no place here for option'
wrong_material 'a parameter twice' 'material svk E=1 nu=0.3 E=1 density=1' 'E= is given twice'
wrong_material 'a parameter without value' 'material svk E= nu=0.3 density=1' 'E= has no value'
wrong_material 'a negative modulus' 'material svk E=-1 nu=0.3 density=1' 'E=-1 must be'
wrong_material 'an incompressible one' 'material svk E=1 nu=0.5 density=1' 'nu=0.5 must be'
wrong_material 'an infinite modulus' 'material svk E=inf nu=0.3 density=1' 'E=inf is no finite number'
wrong_material 'an overflowing modulus' 'material svk E=1e999 nu=0.3 density=1' 'E=1e999 is no finite number'
wrong_material 'letters after a number' 'material svk E=1e3Pa nu=0.3 density=1' 'E=1e3Pa is no finite number'
wrong_material 'a bad region' 'material svk E=1 nu=0.3 density=1 region=one' 'region=one is no integer'
relaxing='material svk E=1 nu=0.3 density=1'
wrong_material 'a relaxation term without its time' "$relaxing g1=0.5" 'without a gap'
wrong_material 'a second relaxation term only' "$relaxing g2=0.5 tau2=1" 'without a gap'
wrong_material 'a relaxation term twice' "$relaxing g1=0.5 g1=0.5 tau1=1" 'g1= is given twice'
wrong_material 'a relaxation time of 0' "$relaxing g1=0.5 tau1=0" 'tau1=0 must be a number > 0'
wrong_material 'too many relaxation terms' "$relaxing g9=0.5 tau9=1" 'at most 8 relaxation terms'
wrong_material 'more relaxation than stress' "$relaxing g1=0.5 tau1=1 g2=0.6 tau2=2" ''
wrong_material 'relaxation of a linear material' "$material g1=0.5 tau1=1" ''
wrong_material 'Mooney-Rivlin without D1' 'material mooney_rivlin C10=1 C01=1 density=1' 'missing option D1'
wrong_material 'Mooney-Rivlin without stiffness' 'material mooney_rivlin C10=1 C01=-1 D1=1 density=1' ''
wrong_material 'a polynomial without C20' 'material reduced_polynomial C10=1 D1=1 density=1' 'missing option C20'

wrong_line 'an unknown statement' 'wobble 1' "unknown statement 'wobble'"
wrong_line 'a second mesh' 'mesh cube.vtk' 'second mesh statement; the first is in line 1'
wrong_line 'a second material' "$material" 'several materials need region='
wrong_line 'an unknown element' 'element penta6' "unknown element 'penta6'"
wrong_line 'an element that does not fit' 'element hex20' 'element hex20 does not fit the mesh, which has hex8'
wrong_line 'patches of other elements' 'element tet4patch' 'element tet4patch does not fit the mesh, which has hex8'
wrong_line 'an element that does not fit' 'element tet10' 'does not fit the mesh'
wrong_line 'two gravity components' 'gravity 0 0' 'word is missing; expected: gravity NUMBER NUMBER NUMBER'
wrong_line 'a gravity of letters' 'gravity 0 0 down' "'down' is no finite number"
wrong_line 'unknown axes' 'fix xw nodes=x0' "'xw' is not axes"
wrong_line 'an axis twice' 'fix xx nodes=x0' "'xx' is not axes"
wrong_line 'fix without nodes' 'fix x' 'missing option nodes'
wrong_line 'a list that is not there' 'fix x nodes=nowhere' 'nowhere: '
wrong_line 'a folder for a list' 'fix x nodes=out' 'out: '
wrong_line 'an empty list' 'fix x nodes=empty' 'the list is empty'
wrong_line 'an index out of range' 'fix x nodes=range' 'range:2: node 8 is not in the mesh'
wrong_line 'an index that is none' 'fix x nodes=fraction' "fraction:2: '1.5' is no node index"
wrong_line 'a node twice' 'fix x nodes=double' 'double:2: node 0 is listed twice'
wrong_line 'two indices on a line' 'fix x nodes=two' 'two:1: the line holds more'
wrong_line 'a zero byte' 'fix x nodes=binary' 'not a text file'
wrong_line 'contradicting supports' 'prescribe z nodes=z0 value=0,0,1' 'axis z of node 0 is already held'
wrong_line 'two numbers for a vector' 'prescribe z nodes=z1 value=0,0' 'must be three finite numbers'
wrong_line 'four numbers for a vector' 'prescribe z nodes=z1 value=0,0,0,0' 'must be three finite numbers'
wrong_line 'a NaN in a list' 'prescribe z file=nan' 'nan:1: the line must hold'
wrong_line 'a short line in a list' 'force file=short' 'short:1: the line must hold'
wrong_line 'nodes= and file=' 'force nodes=z1 file=moves' 'do not go together'
wrong_line 'a ramp in a static case' 'prescribe z nodes=z1 value=0,0,1 ramp=1' 'ramp= is for dynamic'
wrong_line 'a face that is none' 'traction faces=notaface value=0,0,1' 'notaface:1: these 4 nodes are no face'
wrong_line 'a face of three nodes' 'traction faces=side value=0,0,1' 'side:1: these 3 nodes are no face'
wrong_line 'a face twice' 'traction faces=twice value=0,0,1' 'twice:2: the face is listed twice'
wrong_line 'pressure without value' 'pressure faces=top' 'missing option value'
wrong_line 'pressure with a direction' 'pressure faces=top value=0,0,1' 'value=0,0,1 is no finite number'
wrong_line 'pressure on no face' 'pressure faces=notaface value=1' 'notaface:1: these 4 nodes are no face'
wrong_line 'springs without stiffness' 'spring file=moves' 'moves:1: the line must hold a node and four'
wrong_line 'springs that push' 'spring file=pushing' 'pushing:1: the stiffness -1 of the spring must be > 0'
wrong_line 'an unknown output' 'output colour u' "unknown output 'colour'"
wrong_line 'an output without file' 'output reaction' 'word is missing'
wrong_line 'a probe out of range' 'output probe 8 u' 'node 8 is not in the mesh'
wrong_line 'frequencies of a static case' 'output frequencies f' 'does not go with solve static'
wrong_line 'an output into nowhere' 'output reaction nowhere/r' 'cannot be written'
# ... by whatever name it is reached
cat cube.vtk z0 >inputs
ln -s z0 linked
for name in cube.vtk z0 wrong.case linked; do
    wrong_line "an output over its input $name" "output reaction ../$name" 'is read by this case'
done
cat cube.vtk z0 | cmp -s - inputs
result 'inputs are as they were' $?
say 'mesh cube.vtk' "$material" "$symmetry" "$static" >wrong.case
(cd .. && "$program" case/wrong.case -o case/../case/cube.vtk -p case/out/ >stdout 2>stderr)
[ $? = 2 ] && grep -q 'cube.vtk is read by this case' ../stderr && cat cube.vtk z0 | cmp -s - inputs
result 'refuses -o over the mesh' $?

wrong_solve 'no solve' '' 'there is no solve'
wrong_solve 'an unknown solve' 'solve quickly' "unknown solve 'quickly'; known: static euler newmark"
wrong_solve 'no steps' 'solve static steps=0 tol=1e-3' 'steps=0 must be an integer >= 1'
wrong_solve 'half a step' 'solve static steps=1.5 tol=1e-3' 'steps=1.5 is no integer'
wrong_solve 'too many steps' 'solve static steps=99999999999 tol=1e-3' 'is no integer'
wrong_solve 'no tolerance' 'solve static steps=1' 'missing option tol'
wrong_solve 'a tolerance of 1' 'solve static steps=1 tol=1' 'tol=1 must be'
wrong_solve 'no time step' 'solve euler end=1' 'missing option dt'
wrong_solve 'a time step of 0' 'solve newmark dt=0 end=1' 'dt=0 must be'
wrong_solve 'endless steps' 'solve newmark dt=1e-12 end=1' '1e9 steps'
wrong_solve 'newton= for euler' 'solve euler dt=1 end=1 newton=2' 'no place here for option newton'
wrong_solve 'negative damping' 'solve euler dt=1 end=1 alpha=-1' 'alpha=-1 must be'
wrong_solve 'no modes' 'solve modes count=0' 'count=0 must be an integer >= 1'
wrong_solve 'a word for a time step' 'solve central dt=fast end=1' 'dt=fast is no finite number'
wrong_solve 'auto for an implicit time step' 'solve euler dt=auto end=1' 'dt=auto is no finite number'
wrong_solve 'stiffness damping of the explicit scheme' 'solve central dt=1 end=1 beta=1' 'no place here for option beta'
wrong 'displacements of modes' 6 'output displacement does not go with solve modes' <<END
mesh cube.vtk
$material
$symmetry
output displacement u
solve modes count=3
END

wrong 'a second solve' 7 'second solve statement; the first is in line 6' <<END
mesh cube.vtk
$material
$symmetry
$static
solve euler dt=1 end=1
END
wrong 'a region that the mesh has not' 3 'the mesh has no region 5' <<END
mesh region7.vtk
$material region=7
$material region=5
$symmetry
$static
END
wrong 'a region without material' 1 'region 7 of the mesh (element 0) has no material' <<END
mesh region7.vtk
$material region=6
$symmetry
$static
END
wrong 'a region twice' 3 'region 7 has a material already' <<END
mesh region7.vtk
$material region=7
$material region=7
$symmetry
$static
END
wrong 'a static case without supports' 3 'can move freely' <<END
mesh cube.vtk
$material
$static
END
wrong 'one rotation with another material than corotated' 3 'needs the material corotated' <<END
mesh tet10.vtk
element tet10sr
$material
fix xyz nodes=z0tet
$static
END
wrong 'two outputs into one file' 8 'line 7 already writes u' <<END
mesh cube.vtk
$material
$symmetry
$static
output displacement u
output reaction u
END
wrong 'a case without a mesh' 2 'there is no mesh' <<END
$material
$static
END
wrong 'a case without a material' 2 'there is no material' <<END
mesh cube.vtk
$static
END
printf 'mesh cube.vtk\0\n' >zero.case
run zero.case
[ "$run_status" = 2 ] && grep -q '^case/zero.case:1: it is not a text file' ../stderr
result 'refuses a zero byte' $?
run nowhere.case
[ "$run_status" = 2 ] && grep -q '^case/nowhere.case:1: ' ../stderr
result 'refuses a case that is not there' $?
for arguments in '' '-o' '--wrong' '-p x -p y a' '--mass heavy a' 'a -o b c' 'a b c'; do
    (cd .. && "$program" $arguments >stdout 2>stderr)
    [ $? = 2 ] && grep -q '^usage: case_solve' ../stderr && [ ! -s ../stdout ]
    result "refuses the arguments '$arguments'" $?
done
(cd .. && "$program" --help >stdout 2>stderr) && grep -q 'prescribe AXES' ../stdout && [ ! -s ../stderr ]
result 'helps' $?

# ---- what it solves ----

# good NAME CASE [ARGUMENT...]: exit 0, the one line on stdout
good() {
    good_name=$1
    shift
    run "$@"
    [ "$run_status" = 0 ] && [ ! -s ../stderr ] && [ "$(wc -l <../stdout)" -eq 1 ] &&
        grep -Eq '^converged steps=[0-9]+ newton=[0-9]+ pcg=[0-9]+ seconds=[0-9.]+$' ../stdout
    result "$good_name" $?
}
# lines FILE COUNT [AWK CONDITION on every line]: `near(a, b)` compares to 1e-6
lines() {
    awk -v want="$2" "function near(a, b) { return a - b < 1e-6 && b - a < 1e-6 }
        !(${3:-1}) { print FILENAME \": \" \$0; bad = 1 } END { exit bad || NR != want }" "out/$1" >../stdout
    result "$1: $2 lines, ${3:-any}" $?
    rm -f "out/$1"
}

# Uniaxial tension by 10 Pa: strain 0.01 along z, -0.003 across; read with CRLF, comments and odd blanks.
tr '#' '\r' >tension.case <<END
mesh	cube.vtk #
  material linear density=1000  nu=0.3 E=1000
fix x nodes=x0
fix y nodes=y0
fix z nodes=z0
traction faces=top value=0,0,+1e1
solve static tol=1e-10 steps=2
output displacement u
output reaction r
output stress s
output probe 6 p
END
good 'uniaxial tension' tension.case -o case/out/all.vtk
lines u 8 'near($4, $1 < 4 ? 0 : 0.01) && $2 <= 0 && $3 <= 0 && near($2 * $3, $1 % 4 == 2 ? 9e-6 : 0)'
lines r 7 '$1 > 3 || near($4, -2.5)'
lines s 8 '$1 == 0 && $2 == NR - 1 && near($3, 0) && near($4, 0) && near($5, 10) && near($8, 0)'
lines p 3 'near($4, 0.01 * $1) && near($2, -0.003 * $1)'
grep -q '^VECTORS displacement' out/all.vtk && grep -q '^SCALARS von_mises' out/all.vtk
result 'all.vtk has both fields' $?
rm -f out/all.vtk

# The same stretch in other words: a list of displacements, and nodal forces.
say 'mesh cube.vtk' "$material" "$symmetry" 'prescribe z file=moves' "$static" 'output reaction r' >moves.case
good 'prescribed displacements' moves.case
lines r 8 'near($4, $1 < 4 ? 25 : -25)'
say 'mesh cube.vtk' "$material" "$symmetry" 'force nodes=z1 value=0,0,2.5' "$static" \
    'output displacement u' >force.case
good 'nodal forces' force.case
lines u 8 'near($4, $1 < 4 ? 0 : 0.01)'

# The same as an input file of other solvers, whose numbers the outputs have; and one with two mistakes.
cat >tension.inp <<END
*NODE, NSET=ALL
11,0,0,0
12,1,0,0
13,1,1,0
14,0,1,0
15,0,0,1
16,1,0,1
17,1,1,1
18,0,1,1
*ELEMENT, TYPE=C3D8, ELSET=ALL
9,11,12,13,14,15,16,17,18
*NSET, NSET=CORNER
17
*MATERIAL, NAME=GEL
*ELASTIC
1000,.3
*DENSITY
1000
*SOLID SECTION, ELSET=ALL, MATERIAL=GEL
*STEP
*STATIC
.5,1
*BOUNDARY
11,1,3
12,2,3
13,3
14,1
14,3
15,1,2
16,2
18,1
*CLOAD
15,3,2.5
16,3,2.5
17,3,2.5
18,3,2.5
*NODE PRINT, NSET=CORNER
U,RF
*EL PRINT, ELSET=ALL
S
*END STEP
END
good 'an input file of other solvers' tension.inp
lines displacement.txt 8 'near($4, $1 < 15 ? 0 : 0.01) && $2 <= 0 && $3 <= 0'
lines reaction.txt 7 '$1 > 14 || near($4, -2.5)'
lines stress.txt 8 '$1 == 9 && $2 == NR - 1 && near($3, 0) && near($5, 10)'
lines probe_17.txt 3 'near($4, 0.01 * $1) && near($2, -0.003 * $1)'
awk '/^.STEP/ { print "*EQUATION\n2\n17,3,1,17,3,-1" } { print }' tension.inp >joined.inp
run joined.inp
[ "$run_status" = 2 ] && grep -q 'node 17 of the file: node 6 is slave and master' ../stderr
result 'names a node by its number in the file' $?
sed '/^.BOUNDARY/,/^18,1$/d' tension.inp >loose.inp
run loose.inp
[ "$run_status" = 2 ] && grep -q 'with node 1[0-9]* can move freely' ../stderr
result 'names a loose part by the number in the file' $?
sed 's/^17,3,2.5/17,8,2.5/; s/^\*ELASTIC/*PLASTIC/' tension.inp >mistaken.inp
run mistaken.inp
[ "$run_status" = 2 ] && [ ! -s ../stdout ] && [ -z "$(ls out)" ] && [ "$(wc -l <../stderr)" -eq 2 ] &&
    grep -q '^case/mistaken.inp:15: .PLASTIC is not understood' ../stderr &&
    grep -q '^case/mistaken.inp:35: axis 8 of a force' ../stderr
result 'lists the mistakes of an input file' $?

# The same by selections instead of lists, and what is expected of it.
cat >chosen.case <<END
mesh cube.vtk
select nodes x0 plane=0,0,0,2,0,0
select nodes y0 box=-1,0,-1,2,0,2
select nodes z0 near=bottom.vtk distance=.01
select faces top box=0,0,1,1,1,1
select elements all box=0,0,0,1,1,1
$material elements=@all
fix x nodes=@x0
fix y nodes=@y0
fix z nodes=@z0
traction faces=@top value=0,0,10
$static
output displacement u
expect probe 6 value=-.003,.003,.01 tol=1
END
mesh "$cube" 1 5 '4 0 1 2 3' 9 >bottom.vtk
good 'selections' chosen.case
lines u 8 'near($4, $1 < 4 ? 0 : 0.01) && $2 <= 0 && $3 <= 0 && near($2 * $3, $1 % 4 == 2 ? 9e-6 : 0)'
sed 's/value=-.003,.003,.01 tol=1/value=-.003,-.003,.02 tol=.001/' chosen.case >unexpected.case
run unexpected.case
[ "$run_status" = 4 ] && grep -q '^case/unexpected.case:14: node 6 is displaced by -0.003' ../stderr && [ -s out/u ]
result 'an expectation that fails' $?
rm -f out/*
wrong_line 'a selection that is not there' 'fix x nodes=@side' 'there is no `select nodes side`'
wrong_line 'a selection of something else' 'traction faces=@x0 value=0,0,1' 'there is no `select faces x0`'
wrong_line 'an empty selection' 'select faces f plane=0,0,.5,0,0,1' 'the selection is empty'
wrong_line 'a selection by nothing' 'select nodes n' 'missing option'
wrong_line 'a selection in two ways' 'select nodes n box=0,0,0,1,1,1 plane=0,0,0,1,0,0' 'do not go together'
wrong_line 'a box of three numbers' 'select nodes n box=0,0,0' 'box= must be six finite numbers'
wrong_line 'a plane without normal' 'select nodes n plane=0,0,0,0,0,0' 'the normal of the plane has no length'
sed 's/plane=0,0,0,2,0,0/plane=0,0,0,1e-300,0,0/' chosen.case >short_normal.case
good 'a plane with a short normal' short_normal.case
sed 's/plane=0,0,0,2,0,0/plane=0,0,0,1e300,0,0/' chosen.case >long_normal.case
good 'a plane with a long normal' long_normal.case
lines u 8 'near($4, $1 < 4 ? 0 : 0.01)'
wrong_line 'nodes near nothing' 'select nodes n near=nowhere.vtk distance=1' 'nowhere.vtk'
wrong_line 'values from a selection' 'force file=@n' '@n: '
wrong_line 'an expectation out of range' 'expect probe 8 value=0,0,0 tol=1' 'node 8 is not in the mesh'
wrong_line 'surface beside mesh' 'surface surface.vtk' 'surface and stuff go together'
wrong_line 'stuff beside mesh' 'stuff cells=4' 'a second mesh'
say 'mesh cube.vtk' "$material" "$symmetry" 'select nodes n box=0,0,0,1,1,1' 'select nodes n box=0,0,0,1,1,1' \
    "$static" >wrong.case
refused 'a selection twice' 7 'line 6 selects nodes n already'
say 'stuff cells=4' "$material" "$static" >wrong.case
refused 'stuff without surface' 1 'surface and stuff go together'
say 'stuff cells=1001' 'surface cube.vtk' "$material" "$static" >wrong.case
refused 'too many cells' 1 'must be at most 1000'

say 'OFF' '4 3 0' '0 0 0' '1 0 0' '0 1 0' '0 0 1' '3 0 2 1' '3 0 1 3' '3 0 3 2' >open.off
say 'surface open.off' 'stuff cells=4' "$material" "$static" >wrong.case
refused 'a surface with a hole' 1 'edges of one face only'

# A closed surface in millimetres, filled with tets and pulled.
say 'OFF' '8 6 0' '0 0 0' '1000 0 0' '1000 1000 0' '0 1000 0' '0 0 1000' '1000 0 1000' '1000 1000 1000' '0 1000 1000' \
    '4 0 3 2 1' '4 4 5 6 7' '4 0 1 5 4' '4 1 2 6 5' '4 2 3 7 6' '4 3 0 4 7' >cube.off
say 'surface cube.off scale=.001' 'stuff cells=4' "$material" 'select nodes floor box=-1,-1,-1,2,2,.01' \
    'select faces roof plane=0,0,1,0,0,1 distance=.01' 'fix z nodes=@floor' 'select nodes back box=-1,-1,-1,.01,2,2' \
    'fix x nodes=@back' 'select nodes left box=-1,-1,-1,2,.01,2' 'fix y nodes=@left' \
    'traction faces=@roof value=0,0,10' "$static" 'output displacement u' >stuffed.case
good 'a stuffed surface' stuffed.case
awk '$4 > 0.0099 && $4 < 0.0101 { top++ } $4 > 0.0101 { bad = 1 } END { exit bad || top < 9 }' out/u
result 'a stuffed cube stretches as it should' $?
rm -f out/u

# The other loads: a pressure that pulls, and springs as stiff as the cube to points 0.02 above its top.
say 'mesh cube.vtk' "$material" "$symmetry" 'pressure faces=top value=-10' "$static" 'output displacement u' >pull.case
good 'pressure' pull.case
lines u 8 '$1 < 4 ? near($4, 0) : $4 > 0.0098 && $4 < 0.0102'
printf '4 250 0 0 1.02\n5 250 1 0 1.02\n6 250 1 1 1.02\n7 250 0 1 1.02\n' >springs
say 'mesh cube.vtk' 'material linear E=1000 nu=0 density=1000' "$symmetry" 'spring file=springs' "$static" \
    'output displacement u' 'output reaction r' >springs.case
good 'springs' springs.case
lines u 8 'near($4, $1 < 4 ? 0 : 0.01)'
lines r 7 '$1 > 3 || near($4, -2.5)'

# The other materials and elements at small strain: 0.6 Pa on a Young's modulus of 600 Pa (nearly incompressible).
for model in 'neo_hookean C10=100' 'mooney_rivlin C10=60 C01=40' 'reduced_polynomial C10=100 C20=20 C30=5' \
    'mooney_rivlin C10=120 C01=80 g1=0.3 tau1=0.1 g2=0.2 tau2=10'; do
    say 'mesh cube.vtk' 'element hex8bbar' "material $model D1=1e-5 density=1000" "$symmetry" \
        'traction faces=top value=0,0,0.6' "$static" 'output displacement u' >small.case
    good "$model" small.case
    lines u 8 '$1 < 4 ? near($4, 0) : $4 > 0.000995 && $4 < 0.001005'
done

# Modes: six rigid ones of a free cube; a cube that can only stretch has sqrt(3 E / rho) / (2 pi).
say 'mesh cube.vtk' 'material linear E=1000 nu=0 density=1000' 'solve modes count=7' 'output frequencies f' >free.case
good 'modes of a free cube' free.case case/out/all.vtk
lines f 7 '$1 == NR && (NR < 7 ? $2 < 1e-4 : $2 > 0.1)'
grep -q '^VECTORS mode_7' out/all.vtk
result 'all.vtk has the modes' $?
rm -f out/all.vtk
printf '0\n1\n2\n3\n4\n5\n6\n7\n' >all
say 'mesh cube.vtk' 'material linear E=1000 nu=0 density=1000' 'fix xy nodes=all' 'fix z nodes=z0' \
    'solve modes count=1' 'output frequencies f' >stretch.case
good 'the stretching mode' stretch.case
lines f 1 'near($2, 0.275664448)'

# The explicit scheme: free fall, which it hits exactly; its own time step.
say 'mesh cube.vtk' "$material" 'gravity 0 0 -10' 'solve central dt=0.01 end=0.1' 'output probe 6 p' >fall.case
good 'the explicit scheme' fall.case
lines p 11 'near($4, -5 * $1 * $1) && near($2, 0)'
say 'mesh cube.vtk' "$material" 'gravity 0 0 -10' 'solve central dt=auto end=1 alpha=0' 'output displacement u' >auto.case
good 'its own time step' auto.case
lines u 8 'near($4, -5)'

# Relaxation: held at a strain of 0.001 the stress of 0.6 Pa falls to a half.
say 'mesh cube.vtk' 'material neo_hookean C10=100 D1=1e-5 density=0.001 g1=0.5 tau1=0.1' "$symmetry" \
    'prescribe z nodes=z1 value=0,0,0.001 ramp=1e-3' 'solve euler dt=1e-3 end=1 tol=1e-8' 'output reaction r' >relax.case
good 'relaxation' relax.case
lines r 8 '$1 < 4 ? $4 < -0.0749 && $4 > -0.0752 : $4 > 0.0749 && $4 < 0.0752'

# Dynamics: one line per step, the last step shorter; a ramp; the element with one rotation.
for solve in euler newmark; do
    say 'mesh tet10.vtk' 'element tet10sr' 'material corotated E=1000 nu=0.3 density=1000' \
        'fix xyz nodes=z0tet' 'prescribe xyz file=ramp ramp=0.2' 'gravity 0 0 -9.81' \
        "solve $solve dt=0.1 end=0.25 tol=1e-8 alpha=0.1 beta=0.01" 'output probe 3 p' >dynamic.case
    echo '3 0.1 0 0' >ramp
    good "$solve" dynamic.case --mass lumped
    lines p 4 'near($1, NR < 4 ? 0.1 * (NR - 1) : 0.25) && near($2, NR < 3 ? 0.5 * $1 : 0.1) && near($3, 0)'
done

# A solve that fails, here by pushing a cube through itself: the last converged state is written, exit 3.
say 'mesh cube.vtk' 'material neo_hookean C10=1 D1=1 density=1' 'fix xyz nodes=z0' \
    'prescribe xyz nodes=z1 value=0,0,-1.5' 'solve static steps=4 tol=1e-6' 'output displacement u' \
    >crushed.case
run crushed.case
[ "$run_status" = 3 ] && [ ! -s ../stdout ] && grep -q '^case/crushed.case:5: the static' ../stderr
result 'a crushed cube fails' $?
lines u 8 '$1 < 4 ? near($4, 0) : $4 < -0.3 && $4 > -1'

# ---- cuts ----
# A bar of 6 x 2 x 2 m of 144 tets; its ends; a polygon half through it; a box inside it; its sides as quads.
awk 'BEGIN {
    print "# vtk DataFile Version 3.0\nx\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 63 double"
    for (n = 0; n < 63; n++) print n % 7, int(n / 7) % 3, int(n / 21)
    print "CELLS 144 720"
    split("0 1 3 7 0 3 2 7 0 2 6 7 0 6 4 7 0 4 5 7 0 5 1 7", tet, " ")
    for (c = 0; c < 24; c++) {
        at = c % 6 + 7 * (int(c / 6) % 2) + 21 * int(c / 12)
        for (t = 0; t < 24; t += 4) {
            printf "4"
            for (a = 1; a <= 4; a++) {
                v = tet[t + a]
                printf " %d", at + v % 2 + 7 * (int(v / 2) % 2) + 21 * int(v / 4)
            }
            print ""
        }
    }
    print "CELL_TYPES 144"
    for (c = 0; c < 144; c++) print 10
}' >bar.vtk
seq 0 7 62 >bar0
seq 6 7 62 >bar6
printf '3.3 -1 1\n3.3 3 1 # the edge\n\n3.3 3 3\n3.3 -1 3\n' >half
printf '3.3 -1 1\n3.3 3 1\n' >line
printf '3.3 -1 1\n3.3 3\n' >twonumbers
printf '3.3 -1 1\n3.3 3 1 1\n' >fournumbers
printf '3.3 -1 1\n3.3 3 inf\n' >infinite
awk 'BEGIN {
    for (i = 0; i < 8; i++) print "v", 3 + 1.7 * (i % 2 - 0.5), 1 + 1.2 * (int(i / 2) % 2 - 0.5), 1 + 1.2 * (int(i / 4) - 0.5)
    print "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6"
}' >box.obj
bar='mesh bar.vtk
material linear E=1e5 nu=0.3 density=10
fix xyz nodes=bar0'

# Nearly incompressible it hangs down several times as far where the volume is held over patches.
for element in tet4 tet4patch; do
    say 'mesh bar.vtk' "element $element" 'material linear E=1e5 nu=0.4999 density=10' 'fix xyz nodes=bar0' \
        'gravity 0 0 -10' "$static" "output displacement u_$element" >hanging.case
    good "a bar of $element" hanging.case
done
awk 'FNR == 63 { z[NR] = $4 } END { exit !(z[63] < 0 && z[126] < 3 * z[63]) }' out/u_tet4 out/u_tet4patch
result 'patches do not lock' $?
rm -f out/u_tet4 out/u_tet4patch
wrong_cut() { # wrong_cut NAME STATEMENT PATTERN [LINE]
    say "$bar" "$2" 'solve static steps=1 tol=1e-9' >wrong.case
    refused "$1" "${4:-4}" "$3"
}
wrong_cut 'an unknown cut' 'cut sphere' "unknown cut 'sphere'; known: plane polygon surface"
wrong_cut 'a cut of nothing' 'cut' 'cut what? known: plane'
wrong_cut 'a plane with five numbers' 'cut plane 3 0 0 1 0' 'word is missing; expected: cut plane NUMBER'
wrong_cut 'a plane with a letter' 'cut plane 3 0 0 1 0 x' "'x' is no finite number"
wrong_cut 'a plane without a normal' 'cut plane 3 0 0 0 0 0' 'normal of the plane has no length'
wrong_cut 'a plane beside the mesh' 'cut plane 9 0 0 1 0 0' 'the cut meets nothing'
wrong_cut 'a plane cut twice' 'cut plane 3.3 0 0 1 0 0
cut plane 3.3 0 0 1 0 0' 'the cut meets nothing of the mesh that was whole' 5
wrong_cut 'a ball of no size' 'ablate 3 1 1 0' 'radius of the ball is 0, it must be > 0'
wrong_cut 'a ball beside the mesh' 'ablate 9 9 9 0.1' 'the ball has nothing of the mesh in it' 4
wrong_cut 'a ball around the mesh' 'ablate 3 1 1 100' 'the ball takes all of the mesh' 4
wrong_cut 'a ball with three numbers' 'ablate 9 9 9' 'word is missing; expected: ablate NUMBER'
wrong_cut 'a lattice of 3' 'cut plane 3 0 0 1 0 0 lattice=3' 'lattice=3 must be 1, 2 or 4'
wrong_cut 'two lattices' 'cut plane 3.3 0 0 1 0 0 lattice=1
cut plane 4.3 0 0 1 0 0 lattice=2' 'lattice=2 differs from that of a cut before, 1' 5
wrong_cut 'a plane with a file' 'cut plane 3 0 0 1 0 0 file=half' 'no place here for option file'
wrong_cut 'a polygon without a file' 'cut polygon' 'missing option file; expected: cut polygon file='
wrong_cut 'a polygon that is not there' 'cut polygon file=nowhere' 'nowhere: '
wrong_cut 'a polygon of two corners' 'cut polygon file=line' 'line: a polygon needs three corners'
wrong_cut 'a corner of two numbers' 'cut polygon file=twonumbers' 'twonumbers:2: .*three finite numbers'
wrong_cut 'a corner of four numbers' 'cut polygon file=fournumbers' 'fournumbers:2: .*more than it should'
wrong_cut 'an infinite corner' 'cut polygon file=infinite' 'infinite:2: .*three finite numbers'
wrong_cut 'a surface that is not there' 'cut surface file=nowhere.obj' 'nowhere.obj'
wrong_cut 'a surface that is a volume' 'cut surface file=bar.vtk' 'bar.vtk has tet4; a surface is needed'
wrong_cut 'a part that nothing holds' 'cut plane 2.5 0 0 1 0 0' \
    'part 2 of the 2 that the cuts leave can move freely: .* 14 m^3 about (4.25, 1, 1)' 5
wrong_cut 'a box that nothing holds' 'cut surface file=box.obj lattice=4' 'part 2 of the 2 that the cuts leave' 5
say 'mesh tet10.vtk' "$material" 'fix xyz nodes=z0tet' 'cut plane 0 0 0.6 0 0 1' 'solve static steps=1 tol=1e-9' 'output displacement u' \
    >tip.case
"$program" tip.case >../stdout 2>../stderr
[ $? = 0 ] && grep -q '^tip.case:4: note: the cuts leave parts smaller than an element, which are held: 2' ../stderr
result 'the tip of a tet10 comes loose' $?
wrong_line 'cuts of other elements' 'cut plane 0.5 0 0 1 0 0' 'elements of type hex8 cannot be cut, only tet4 and tet10'
say 'mesh bar.vtk' "$material" 'fix xyz nodes=bar0' 'cut polygon file=half' 'solve static steps=1 tol=1e-9' \
    'output displacement half' >overwriting.case
"$program" overwriting.case >../stdout 2>../stderr
[ $? = 2 ] && grep -q '^overwriting.case:6: half is read by this case' ../stderr && grep -q 'the edge' half
result 'refuses to overwrite a polygon' $?

# Cut through, an end that is drawn away pulls at nothing; the weight of each part hangs on its own end.
say "$bar" 'cut plane 3.3 0 0 1 0.2 0.1' 'gravity 0 0 -10' 'prescribe xyz nodes=bar6 value=0.01,0,0' \
    'solve static steps=1 tol=1e-11' 'output reaction r' 'output displacement u' >through.case
good 'a bar cut through' through.case
awk '{ at = $1 % 7 ? 1 : 0; x[at] += $2; z[at] += $4 }
    function near(a, b) { return (a - b) ^ 2 < 1e-12 }
    END { print x[0], x[1], z[0], z[1]; exit !(near(x[0], 0) && near(x[1], 0) && near(z[0] + z[1], 2400) && z[0] > 1200) }' \
    out/r >../stdout
result 'each end carries its part' $?
lines r 18
rm -f out/u
# Half through: it bends more, has skin and lips, and a stress for each piece.
say "$bar" 'gravity 0 0 -10' 'solve static steps=1 tol=1e-9' 'output displacement whole' >whole.case
good 'a whole bar' whole.case
say "$bar" 'gravity 0 0 -10' 'cut polygon file=half' 'solve static steps=1 tol=1e-9' 'output displacement u' \
    'output stress s' >half.case
good 'a bar cut half through' half.case case/out/all.vtk
awk 'NR == FNR { if ($1 == 62) a = $4; next } $1 == 62 { exit !($4 < 1.02 * a) }' out/whole out/u
result 'it bends more' $?
rm -f out/whole out/u
grep -q '^SCALARS lip' out/all.vtk && grep -q '^VECTORS displacement' out/all.vtk && grep -q '^SCALARS von_mises' out/all.vtk
result 'all.vtk has skin and lips' $?
awk '{ n[$1]++ } END { for (e in n) { pieces += n[e] > 1; most = e > most ? e : most } exit !(NR > 144 && pieces > 5 && most + 0 < 144) }' out/s
result 'a stress for each piece' $?
rm -f out/s out/all.vtk
# A ball out of its top: it weighs less, by what the ball has in it, and bends more.
say "$bar" 'gravity 0 0 -10' 'ablate 3 1 2 0.7 lattice=4' 'solve static steps=1 tol=1e-10' 'output reaction r' \
    'output displacement u' >burnt.case
good 'a bar with a hole' burnt.case case/out/all.vtk
awk '{ z += $4 } END { gone = (2400 - z) / 100; print gone; exit !(gone > 0.66 && gone < 0.74) }' out/r >../stdout
result 'it weighs less by half a ball' $?
grep -q '^SCALARS lip' out/all.vtk
result 'all.vtk has the wall of the hole' $?
rm -f out/r out/u out/all.vtk
# Planes that meet leave a crumb, which is held and told.
say "$bar" 'fix xyz nodes=bar6' 'cut plane 3.3 1 1.1 1 0 0.15' 'cut plane 3.3 1 1.1 1 0.1 -0.15' \
    'solve static steps=1 tol=1e-9' 'output displacement u' >crumbs.case
run crumbs.case
[ "$run_status" = 0 ] && grep -q '^converged' ../stdout &&
    grep -q '^case/crumbs.case:5: note: the cuts leave parts smaller than an element, which are held: 1' ../stderr
result 'crumbs are held' $?
rm -f out/u
# What is cut off falls freely; copies of prescribed nodes go with them.
say "$bar" 'gravity 0 0 -10' 'cut plane 3.3 0 0 1 0 0' 'solve euler dt=0.1 end=0.3 tol=1e-9' 'output displacement u' \
    >falling.case
good 'a part falls' falling.case
lines u 63 '$1 % 7 < 4 || near($4, -0.6)'
say 'mesh bar.vtk' 'material linear E=1e5 nu=0.3 density=10' 'prescribe xyz nodes=bar0 value=0,0.1,0 ramp=0.5' \
    'prescribe xyz nodes=bar6 value=0,0.1,0 ramp=0.5' 'cut plane 0 0 0.9 0 0 1' \
    'solve euler dt=0.1 end=4 tol=1e-9 alpha=5' 'output displacement u' >carried.case
good 'copies follow a ramp' carried.case
lines u 63 '($3 - 0.1) ^ 2 < 1e-8 && $4 ^ 2 < 1e-8'

# ---- studies of parameters ----
printf 'young, nu,load   # a comment\n\n1000,0.3,-10\n2000,0.3,-10\n500,0.1,-20\n1e3,0.45,-1\n2000,0.3,-40\n' >table.csv
say 'mesh cube.vtk   # $none of these' 'material linear E=$young nu=${nu} density=1000' "$symmetry" \
    'traction faces=top value=0,0,$load' "$static" 'output probe 6 tip' 'output probe 0 corner' >vary.case
study() { # study NAME STATUS PATTERN ROWS [ARGUMENT...]: from FOLDER; PATTERN in what is printed
    study_name=$1 study_status=$2 study_pattern=$3 study_rows=$4
    shift 4
    (cd .. && "$program" case/vary.case --study "$study_rows" "$@" >stdout 2>stderr)
    [ $? = "$study_status" ] && cat ../stdout ../stderr | grep -q -e "$study_pattern"
    result "study: $study_name" $?
}
study 'all cases' 0 '^study: 5 cases, shard 1 of 1, 5 to do$' whole.csv --vary case/table.csv
# of a cube that is pulled: load / E up and -nu load / E across
awk -F, 'NR > 2 { ok += $1 == NR - 3 && $5 == "converged" && ($11 * $2 / $4 - 1) ^ 2 < 1e-16 &&
    ($9 * $2 / $4 + $3) ^ 2 < 1e-16 && $12 == 0 } END { exit !(ok == 5 && NR == 7) }' ../whole.csv
result 'study: what theory has' $?
[ ! -e ../tip ] && [ -z "$(ls out)" ]
result 'study: no other outputs' $?
for share in 1 2 3; do
    study "share $share" 0 "^study: 5 cases, shard $share of 3" share$share.csv --vary case/table.csv --shard $share/3
done
(cd .. && sh "$study_merge" merged.csv share1.csv share2.csv share3.csv && cmp merged.csv whole.csv) >../stdout 2>../stderr
result 'study: shares join to the same bytes' $?
head -c -30 ../whole.csv >../killed.csv
study 'goes on' 0 'shard 1 of 1, 1 to do' killed.csv --vary case/table.csv
cmp ../killed.csv ../whole.csv >../stdout 2>../stderr
result 'study: killed and run again' $?
{ printf '\357\273\277' && sed 's/$/\r/' table.csv; } >windows.csv # a byte order mark, carriage returns
study 'a table of another system' 0 '^study: 5 cases' windows_rows.csv --vary case/windows.csv
[ "$(sed 1d ../windows_rows.csv)" = "$(sed 1d ../whole.csv)" ]
result 'study: the same rows of it' $?
cp ../whole.csv ../kept.csv
printf 'young,nu,load\n1000,0.3,1\n' >other.csv
study 'rows of another table' 2 'whole.csv: is of another study' whole.csv --vary case/other.csv
cmp ../kept.csv ../whole.csv >../stdout 2>../stderr
result 'study: rows are kept' $?
bad_table() { # bad_table PATTERN LINE...
    bad_pattern=$1
    shift
    say "$@" >bad.csv
    study "refuses $bad_pattern" 2 "$bad_pattern" none.csv --vary case/bad.csv
    [ ! -e ../none.csv ]
    result "study: no rows of $bad_pattern" $?
}
bad_table 'case/vary.case:6: the table does not name .load' 'young,nu' '1,0.2'
bad_table 'bad.csv:2: has another number of words' 'young,nu,load' '1,0.2'
bad_table 'bad.csv:1: has no case' 'young,nu,load'
bad_table 'bad.csv:1: is no name (letters, digits, _): 9g' 'young,9g' '1,2'
bad_table 'bad.csv:1: is named twice: nu' 'nu,nu' '1,2'
bad_table 'bad.csv:2: needs a comma between the words of 1 0.3' 'young,nu' '1 0.3,4'
bad_table 'bad.csv:2: has an empty place' 'young,nu' '1,'
bad_table 'case/vary.case:2: E=soft' 'young,nu,load' 'soft,0.3,1'
say 'young,nu,load' '1000,0.3,1' '-5,0.3,1' >late.csv
study 'a case that is wrong' 2 'late.csv: case 1 of the table:' late_rows.csv --vary case/late.csv
say 'mesh cube.vtk' 'material neo_hookean E=1000 nu=0.3 density=1000' "$symmetry" 'traction faces=top value=0,0,$load' \
    'solve static steps=1 tol=1e-8 iterations=3' >hard.case
say 'load' '-10' '-1e6' '-20' >hard.csv
(cd .. && "$program" case/hard.case --vary case/hard.csv --study hard_rows.csv >stdout 2>stderr &&
    grep -q '^study: 1 cases failed' stderr && [ "$(sed 1d hard_rows.csv | cut -d, -f 3 | tr '\n' ' ')" = 'end converged failed converged ' ])
result 'study: cases that fail are rows like others' $?
{ cat vary.case && echo 'expect probe 6 value=$x,$x,$z tol=1e-9'; } >expect.case # 2 % across, 1 % up; the second is off
say 'young,nu,load,x,z' '1000,0.3,-10,0.003,-0.01' '1000,0.3,-10,0.003,-0.011' '500,0,-10,0,-0.02' >expect.csv
(cd .. && "$program" case/expect.case --vary case/expect.csv --study expect_rows.csv >stdout 2>stderr &&
    grep -q 'case/expect.case:[0-9]*: case 1 of the table: node 6 is displaced by 0.003,0.003,-0.01 m, 0.001 m from' stderr &&
    grep -q '^study: 1 cases are not as expected, and their rows say so$' stderr && [ "$(wc -l <stderr)" = 2 ] &&
    [ "$(sed 's/.*,//' expect_rows.csv | tail -n +2 | tr '\n' ' ')" = 'expected yes no yes ' ])
result 'study: expectations are checked in each row' $?
{ cat hard.case && echo 'expect probe 6 value=0,0,0 tol=9'; } >hard_expect.case
(cd .. && "$program" case/hard_expect.case --vary case/hard.csv --study hard_expect.csv >stdout 2>stderr &&
    [ "$(sed 's/.*,//' hard_expect.csv | tail -n +2 | tr '\n' ' ')" = 'expected yes  yes ' ])
result 'study: a case that fails has nothing to be expected' $?
study 'a share that is none' 2 'needs I/N with 1 <= I <= N' none.csv --vary case/table.csv --shard 4/3
study 'no table' 2 '^usage: case_solve' none.csv
study 'no folder' 2 'no-such/rows.csv' no-such/rows.csv --vary case/table.csv

# ---- a reference case through the program ----
if [ -r "$shared/reference/nh_cantilever_tet4/case.case" ]; then
    (cd .. && "$program" "$shared/reference/nh_cantilever_tet4/case.case" -p case/out/ >stdout 2>stderr)
    result 'nh_cantilever_tet4' $?
    awk '/^#/ { next } NR == FNR { for (k = 2; k < 5; k++) u[$1, k] = $k; next }
        { for (k = 2; k < 5; k++) { d += ($k - u[$1, k]) ^ 2; s += $k ^ 2 } }
        END { print "relative difference " sqrt(d / s); exit !(d < 1e-6 * s) }' \
        "$shared/reference/nh_cantilever_tet4/solution.txt" out/out_displacement.txt >../stdout
    result 'nh_cantilever_tet4 agrees to 1e-3' $?
else
    echo 'skip: no shared folder with reference cases'
    skipped=1
fi

echo "$passed passed, $failed failed, $skipped skipped"
[ "$failed" = 0 ]
