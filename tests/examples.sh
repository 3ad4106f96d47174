#!/bin/sh
# Runs case_convert, hello, custom_element, demo, viscoelastic, haptic_loop, liver_models, surface_to_sim, cylinder_study,
# viewer, umesh, particles_study, the needle programs, grasp, palpation, identify, drop, breathing, igtl_server, igtl_client, cut_scalpel, cautery, ablation, cut_resect,
# cut_force, cut_study, one_body, register_liver, track_liver and insilico as
# a user would, with good and bad arguments and files:
#
#     tests/examples.sh PROGRAMS FOLDER       programs in PROGRAMS (build), files into FOLDER, which is emptied
#
# With CHECK_QUICK in the environment the longest runs whose like others have are left out. Data comes from $SHARED
# (default ../shared); what needs it is skipped where it is missing. Ends with `N passed, N failed, N skipped`.
here=$(cd "$(dirname "$0")" && pwd)
programs=$(cd "$1" && pwd) folder=$2
shared=${SHARED:-../shared}
data=$(cd "$shared/data" 2>/dev/null && pwd)
passed=0 failed=0 skipped=0
rm -rf "$folder"
mkdir -p "$folder"
cd "$folder" || exit 1

pass() { passed=$((passed + 1)); }
fail() {
    echo "FAILED: $1"
    failed=$((failed + 1))
}
skip() {
    echo "skip: $1"
    skipped=$((skipped + 1))
}

# expect STATUS PATTERN PROGRAM [ARGUMENT...]: the exit status, and a line of output or error that matches
expect() {
    status=$1 pattern=$2 program=$3
    shift 3
    "$programs/$program" "$@" >output.txt 2>&1
    got=$?
    if [ $got = "$status" ] && grep -q -e "$pattern" output.txt; then
        pass
    else
        fail "$program $*: exit status $got, expected $status and '$pattern'"
        tail -n 3 output.txt
    fi
}
# The same when the data is there; the file is the last argument, named from the data folder.
expect_data() {
    status=$1 pattern=$2 program=$3 file=$4
    shift 4
    if [ -n "$data" ] && [ -e "$data/$file" ]; then
        expect "$status" "$pattern" "$program" "$@" "$data/$file"
    else
        skip "no $file: $program $*"
    fi
}
is_whole() { [ -z "${CHECK_QUICK:-}" ]; }
long() { # long COMMAND...: left out where time is short
    if is_whole; then "$@"; fi
}
check() { # check WHAT COMMAND...: the command succeeds
    what=$1
    shift
    if "$@"; then pass; else fail "$what"; fi
}
is_png() { # signature, header, 1280 x 960, not almost empty
    head=$(od -An -tx1 -N26 "$1" | tr -d ' \n')
    [ "$head" = 89504e470d0a1a0a0000000d4948445200000500000003c00802 ] && [ "$(wc -c <"$1")" -gt 50000 ]
}
is_frame() { # a VTK file with the three fields
    for field in 'VECTORS displacement' 'VECTORS velocity' 'SCALARS von_mises'; do
        grep -a -q "^$field " "$1" || return 1
    done
}
is_gone() { [ ! -e "$1" ]; }
quietly() { "$@" >/dev/null 2>&1; }
refuses() { # refuses WORDS COMMAND...: it fails, and says so
    words=$1
    shift
    ! "$@" >refused.txt 2>&1 && grep -q "$words" refused.txt
}
count_frames() { ls "$1"/demo_*.vtk 2>/dev/null | wc -l | tr -d ' '; }

# ---- case_convert ----
tests=$OLDPWD/tests/data
same_numbers() { # same_numbers FILE FILE: lines NODE UX UY UZ that agree within 1e-5 of the largest vector
    awk 'FNR == NR { for (k = 2; k < 5; k++) u[$1, k] = $k; next }
        NF == 4 && ($1, 2) in u {
            d = m = 0
            for (k = 2; k < 5; k++) { d += ($k - u[$1, k]) ^ 2; m += u[$1, k] ^ 2 }
            if (d > difference) difference = d
            if (m > size) size = m
            count++
        }
        END { exit !(count > 3 && size > 0 && difference <= 1e-10 * size) }' "$1" "$2"
}
expect 0 '^case_convert IN OUT' case_convert --help
expect 2 '^usage: case_convert' case_convert only.inp
expect 2 'must end in .case, .inp, .feb or .scn' case_convert a.inp b.vtk
expect 2 'must end in .case, .inp, .feb or .msml.xml' case_convert a.scn b.inp
expect 2 'no-such.inp:1: No such file' case_convert no-such.inp b.case
expect 2 'mistakes.inp:8: elements C3D8R are not read' case_convert "$tests/mistakes.inp" b.case
check "all ten mistakes are listed" [ "$(wc -l <output.txt)" = 10 ]
check "case_convert writes nothing of a wrong file" is_gone b.case
expect 0 '^block.case: 36 nodes, 12 hex8$' case_convert "$tests/block.inp" block.case
expect 0 '^block.inp: 36 nodes, 12 hex8$' case_convert block.case block.inp
expect 0 '^again.case: 36 nodes' case_convert block.inp again.case
check "a case comes back the same" eval "sed 's/again_/block_/' again.case | cmp -s - block.case && cmp -s again_mesh.vtk block_mesh.vtk"
expect 2 'block.case is read by this case' case_convert block.case ./block.case
expect 0 '^converged' case_solve block.inp -p block_
expect 0 '^converged' case_solve "$tests/block.inp" -p given_
check "both files have the same solution" same_numbers block_displacement.txt given_displacement.txt
printf '%s\n' '35 20.5 .034 .025 .026' '34 20.5 .02 1e-7 .03' '34 100 .02 .02 .02' >hook.txt
{ cat block.case && echo 'spring file=hook.txt'; } >hung.case
expect 0 '^hung.inp: 36 nodes, 12 hex8$' case_convert hung.case hung.inp
expect 0 '^back.case: 36 nodes' case_convert hung.inp back.case
expect 0 '^hung2.inp: 36 nodes' case_convert back.case hung2.inp
expect 0 '^back2.case: 36 nodes' case_convert hung2.inp back2.case
check "springs come back the same" eval "sed 's/back2_/back_/' back2.case | cmp -s - back.case && cmp -s back_*_spring.txt back2_*_spring.txt && cmp -s back2_mesh.vtk block_mesh.vtk"
check "they are those of the case" eval "awk '{ print \$1, \$2 + 0, \$3 + 0, \$4 + 0, \$5 + 0 }' hook.txt >hook_1.txt; awk '{ print \$1, \$2 + 0, \$3 + 0, \$4 + 0, \$5 + 0 }' back_*_spring.txt | cmp -s - hook_1.txt"
expect 0 '^converged' case_solve hung.case -p hung_
expect 0 '^converged' case_solve hung.inp -p hung_inp_
awk '{ $1++; print }' hung_displacement.txt >hung_by_number.txt
check "springs of an input file are those of the case" same_numbers hung_inp_displacement.txt hung_by_number.txt
printf '%s\n' 'mesh block_mesh.vtk' 'material corotated E=1e3 nu=.3 density=1e3' 'fix xyz nodes=block_1_fix.txt' \
    'solve static steps=1 tol=1e-8' >turning.case
{ cat block.case && echo 'expect probe 0 value=0,0,0 tol=1'; } >expected.case
expect 0 'expected.case:[0-9]*: expect probe is left out' case_convert expected.case expected.inp
expect 2 'turning.case:2: material corotated with E and nu cannot be said' case_convert turning.case turning.inp
expect 2 'block_mesh.vtk is read by this case' case_convert turning.case block.case
expect 0 '^turning.inp: 36 nodes' case_convert --as-svk turning.case turning.inp
check "units are in the first line" grep -q '^.. units: m, s, force 1e-4 N' turning.inp

# A reduced polynomial is Yeoh's law; the same block with another law is written as it was before.
expect 0 '^yeoh.feb: 36 nodes, 12 hex8$' case_convert "$tests/block.inp" yeoh.feb
check "a reduced polynomial is Yeoh's law" grep -q 'type="Yeoh"' yeoh.feb
sed 's/REDUCED POLYNOMIAL, N=2/MOONEY-RIVLIN/; s/^3E7, 1E7, 2E-8, 1E30/3E7, 1E7, 2E-8/' "$tests/block.inp" >gel.inp
expect 0 '^gel.feb: 36 nodes, 12 hex8$' case_convert gel.inp gel.feb
check "a file of FEBio is the one that was looked at" cmp -s gel.feb "$tests/block.feb"
expect 0 '^back.case: 36 nodes, 12 hex8$' case_convert gel.feb back.case
expect 0 '^back.feb: 36 nodes, 12 hex8$' case_convert back.case back.feb
check "a file of FEBio comes back the same" cmp -s back.feb gel.feb
expect 0 '^converged' case_solve gel.inp -p gel_
expect 0 '^converged' case_solve gel.feb -p back_
check "a model of FEBio has the same solution" same_numbers gel_displacement.txt back_displacement.txt
expect 2 'mistakes.feb:9: material type Ogden is not read' case_convert "$tests/mistakes.feb" b.case
check "all ten mistakes are listed" [ "$(wc -l <output.txt)" = 10 ]
check "case_convert writes nothing of a wrong file of FEBio" is_gone b.case
expect 0 '^turning.feb: 36 nodes' case_convert turning.case turning.feb --as-svk
expect 2 'turning.case:2: material corotated cannot be said: FEBio has no such law; --as-svk' case_convert turning.case t.feb
check "case_convert writes nothing that it cannot say" is_gone t.feb
expect 0 '^gel.case: 36 nodes' case_convert gel.inp gel.case
sed 's/^solve.*/solve modes count=3/; /^output/d' gel.case >humming.case
expect 2 'solve modes cannot be said' case_convert humming.case humming.feb
expect 0 '^turning.scn: 36 nodes, 12 hex8$' case_convert turning.case turning.scn
expect 2 'block.case:2: material neo_hookean with D1 cannot be said: SOFA has no such law' case_convert block.case block.scn
check "case_convert writes no scene that it cannot say" is_gone block.scn

# A file of MSML, whose mesh is beside it.
cp "$tests/beam.msml.xml" "$tests/beam.vtk" .
expect 0 '^beam.case: 20 nodes, 24 tet4$' case_convert beam.msml.xml beam.case
expect 0 'beam.msml.xml:40: operator <copyFile> is left out' case_solve beam.msml.xml -p msml_
expect 0 '^converged' case_solve beam.case -p by_case_
check "a model of MSML has the same solution" same_numbers msml_displacement.txt by_case_displacement.txt
expect 2 'beam.msml.xml:45: solve euler cannot be said' case_convert beam.msml.xml beam.inp
expect 0 '^beam.scn: 20 nodes' case_convert beam.msml.xml beam.scn
sed 's/dynamicImplicitEuler/Newmark/' beam.msml.xml >waves.msml.xml
expect 0 '^waves.inp: 20 nodes' case_convert waves.msml.xml waves.inp
expect 0 '^waves.feb: 20 nodes' case_convert waves.msml.xml waves.feb --as-svk
expect 2 'mistakes.msml.xml:11: <contact> is not understood' case_convert "$tests/mistakes.msml.xml" b.case
check "all ten mistakes are listed" [ "$(wc -l <output.txt)" = 10 ]
check "case_convert writes nothing of a wrong file of MSML" is_gone b.case
if command -v ccx >/dev/null 2>&1; then
    check "CalculiX solves it" eval "ccx block >ccx.txt 2>&1"
    awk '/displacements/ { on = 1 } on && NF == 4' block.dat >ccx_displacement.txt
    check "CalculiX finds the same displacements" same_numbers block_displacement.txt ccx_displacement.txt
    check "CalculiX solves it with springs" eval "ccx hung >ccx.txt 2>&1"
    awk '/displacements/ { on = 1 } on && NF == 4' hung.dat >ccx_displacement.txt
    check "CalculiX' springs pull alike" same_numbers hung_inp_displacement.txt ccx_displacement.txt
    { sed '/^material/d; /^pressure/d' hung.case && for region in 3 5; do
        echo "material linear E=${region}e3 nu=.3 density=1000 region=$region"
    done; } >lined.case
    expect 0 '^lined.inp' case_convert lined.case lined.inp
    expect 0 '^converged' case_solve lined.inp -p lined_
    check "CalculiX solves a linear step with springs" eval "ccx lined >ccx.txt 2>&1"
    awk '/displacements/ { on = 1 } on && NF == 4' lined.dat >ccx_displacement.txt
    check "CalculiX' springs pull alike in linear steps" same_numbers lined_displacement.txt ccx_displacement.txt
else
    skip "no ccx: case_convert's file is not solved by CalculiX"
fi

# ---- hello ----
expect 0 'sags by [0-9.]* mm, .*stress is [0-9]* Pa' hello
expect_data 0 'sags by [0-9.]* mm, .*stress is [0-9]* Pa' hello volumes/liver_a_tet4_2k.vtk
expect 1 'no-such-file.vtk' hello no-such-file.vtk
check "what it wants is said" grep -q '^usage: hello' output.txt
expect_data 1 'nan_coordinate.vtk:9: ' hello bad/nan_coordinate.vtk
expect_data 1 'volume' hello surfaces/liver_a.obj

# ---- custom_element ----
expect 0 'patch test: 54 distorted wedges, a linear field is met to [0-9.]*e-1[56] of itself' custom_element
check "custom_element names its file" grep -q 'beam: 216 wedges, .*: custom_element.vtk$' output.txt
check "216 VTK wedges" [ "$(grep -c '^13$' custom_element.vtk)" = 216 ]
check "with displacement and stress" grep -q '^SCALARS von_mises' custom_element.vtk
expect 0 'beam: 8 wedges, .*coarse.vtk' custom_element -n 1 -o coarse.vtk
expect 0 '^custom_element \[-n CELLS\]' custom_element --help
expect 2 'from 1 to 20, not 0' custom_element -n 0
expect 2 'from 1 to 20, not 3x' custom_element -n 3x
expect 2 '-o needs a value' custom_element -o
expect 2 'wedge.vtk is no option' custom_element wedge.vtk
expect 3 'no-such-folder/x.vtk: the file cannot be opened' custom_element -n 1 -o no-such-folder/x.vtk
expect 0 'it sags by' hello coarse.vtk # wedges are split into tets

# ---- demo without a file: everything is written and named ----
expect 0 'Hz' demo -o plain --frames 20 --every 5
check "demo names its frames" grep -q 'plain/demo_0000.vtk' output.txt
check "demo names its picture" grep -q 'plain/demo.png' output.txt
check "demo says how it goes on" grep -q 'frame 20 of 20' output.txt
check "demo.png is a picture" is_png plain/demo.png
check "5 frames" [ "$(count_frames plain)" = 5 ]
check "the last frame has its fields" is_frame plain/demo_0004.vtk
check "the series names all frames" [ "$(grep -c '"name": "demo_000' plain/demo.vtk.series)" = 5 ]
expect 0 'sags' hello plain/demo_0004.vtk

# ---- demo's options ----
expect 0 'usage: demo' demo --help
check "help lists every option" [ "$(grep -c '^  -' output.txt)" = 13 ]
expect 0 'Hz' demo --no-vtk -o bare --frames 20 --picture elsewhere.png
check "--no-vtk writes no frames" [ "$(count_frames bare)" = 0 ]
check "--picture names the picture" is_png elsewhere.png
check "the same picture again" cmp -s elsewhere.png plain/demo.png
long expect 0 'Hz' demo -o zero --every 0 --frames 10 --material stable_neo_hookean --young 20000 --poisson 0.3 \
    --density 1000 --dt 0.01 --threads 1
check "--every 0 writes no frames" [ "$(count_frames zero)" = 0 ]

# ---- demo with files ----
for file in volumes/liver_a_tet4_10k.vtk volumes/liver_a_tet10_2k.msh volumes/beam_hex8.vtk; do
    name=$(basename "$file")
    expect_data 0 'Hz' demo "$file" -o "$name.out" --frames 20 --every 20
    [ -d "$name.out" ] && check "$name: a picture" is_png "$name.out/demo.png"
    [ -d "$name.out" ] && check "$name: a frame" is_frame "$name.out/demo_0001.vtk"
done
long expect_data 0 'add --scale 0.001' demo volumes/liver_a_tet4_2k.vtk --scale 1000 --frames 10 --no-vtk -o large
long expect_data 0 '215 x 148 x 164 mm' demo volumes/liver_a_tet4_10k.vtk --scale 1 --frames 10 --no-vtk -o scaled

# ---- wrong usage ----
expect 2 '--frames needs a value' demo --frames
expect 2 '--frames needs a whole number' demo --frames many
expect 2 '--frames needs a whole number' demo --frames 12.5
expect 2 '--frames needs a whole number' demo --frames 0
expect 2 '--dt needs a number' demo --dt -1
expect 2 '--young needs a number' demo --young nan
expect 2 '--poisson needs a number' demo --poisson 0.5
expect 2 'jelly is no material' demo --material jelly
expect 2 '--speed is no option' demo --speed 3
expect 2 'b.vtk is a second file' demo a.vtk b.vtk
expect 2 '-o needs a value' demo -o

# ---- files that cannot be read ----
expect 2 'no-such-file.vtk' demo no-such-file.vtk
expect_data 2 'nan_coordinate.vtk:9: ' demo bad/nan_coordinate.vtk
expect_data 2 'inverted_tets.vtk.*element' demo bad/inverted_tets.vtk
expect_data 2 'random_bytes.vtk' demo bad/random_bytes.vtk
expect_data 2 'is a surface.*surface_to_sim' demo surfaces/liver_a.obj

# ---- what cannot be written ----
echo "in the way" >file
expect 2 'file/below cannot be made' demo -o file/below
expect 2 'file' demo -o file --frames 10
expect 2 'file/demo.png cannot be written' demo -o file --frames 10 --no-vtk
expect 2 'no-such-folder/x.png cannot be written' demo --picture no-such-folder/x.png --frames 10 --no-vtk -o bare
check "nothing is left of it" is_gone no-such-folder

# ---- a solve that fails: so soft that its own weight crushes what must not turn inside out ----
soft=$data/volumes/liver_a_tet4_2k.vtk # demo's own organ takes four times as long
[ -e "$soft" ] || soft=
long expect 3 'frame [0-9]*: the step failed' demo --material neo_hookean --young 10 --dt 0.1 --frames 10 --no-vtk \
    -o soft ${soft:+"$soft"}
long check "the element is named" grep -q 'element [0-9].*SB_ERROR' output.txt

# ---- viscoelastic ----
expect 0 'usage: viscoelastic' viscoelastic --help
expect 0 'Kim et al. 2005' viscoelastic -o curves --points 30
check "a chart" grep -q '</svg>' curves.svg
check "a curve for each model in both panels" [ "$(grep -c '<path fill="none"' curves.svg)" = 8 ]
check "a line for each time" [ "$(wc -l <curves.csv)" = 42 ]
check "what is left of a stress is what the Prony terms leave" awk '
    /^Jordan/ { if ($(NF - 3) > 15 && $(NF - 3) < 20) good++ }
    /^simplified/ { if ($(NF - 3) > 99.9 && $(NF - 3) < 100.1) good++ } END { exit good != 2 }' output.txt
expect 2 'must be after --ramp' viscoelastic --ramp 100 --end 10
expect 2 '--stretch needs a number from' viscoelastic --stretch 0
expect 2 'speed is one word too many' viscoelastic speed
expect 2 'cannot be written' viscoelastic -o no-such-folder/x

# ---- haptic_loop ----
expect 0 'usage: haptic_loop' haptic_loop --help
expect 0 'call       median [0-9.]* us, p99.9 [0-9.]* us' haptic_loop --turns --seconds 4 -o loop
check "a hand with its model rests" awk '/^swing/ { exit !($2 < 0.2) }' output.txt
check "a chart" grep -q '</svg>' loop.svg
check "a line for each call" [ "$(wc -l <loop.csv)" = 4001 ]
expect 0 'loop.svg, loop.csv' haptic_loop --turns --seconds 4 -o loop
expect 0 'written' haptic_loop --hold --seconds 4 -o held
check "a hand that is given held forces swings" awk '/^swing/ { exit !($2 > 5) }' output.txt
expect 0 'written' haptic_loop --seconds 1 -o threads
expect 2 '--young needs a number from' haptic_loop --young 0
expect 2 'slow is one word too many' haptic_loop slow
expect 2 'cannot be written' haptic_loop --turns --seconds 1 -o no-such-folder/x

# ---- devices that there are only names of ----
expect 0 '[0-9]* calls, [0-9]* frames, up to 0.[3-9]' haptic_openhaptics 1
expect 0 '[0-9]* calls, [0-9]* frames, up to 0.[3-9]' haptic_chai3d 1

# ---- liver_models ----
# Under breathing the linear model is far off, all others are close to the reference (thesis, table 4.4).
ranking() {
    awk '/^distance/ { table = 1 } table && / \/ / { name = $1; sub(/^[A-Za-z -]*(2[0-9]*)?[^0-9]*/, ""); most[name] = $1 }
        END { exit !(most["linear"] > 2.5 * most["Jordan"] && most["linear"] > 2.5 * most["Kim"] &&
                     most["linear"] > 5 * most["simplified"] && most["linear"] > 5 * most["corotated"]) }' output.txt
}
expect 0 'usage: liver_models' liver_models --help
mkdir -p livers
expect 0 'respiration_5.vtk' liver_models $(is_whole && echo --cells 6 --steps 4 || echo --cells 6 --steps 2) -o livers
check "linear is far off, the others are close" ranking
check "a VTK file for each model and pattern" [ "$(ls livers | wc -l)" -eq 12 ]
long expect_data 0 'simplified neo-Hookean' liver_models volumes/liver_a_tet10_1k.vtk --steps 3
expect 2 'no-such-file.vtk' liver_models no-such-file.vtk
expect_data 2 'is a surface' liver_models surfaces/liver_a.obj
expect_data 2 'nan_coordinate.vtk:9: ' liver_models bad/nan_coordinate.vtk
expect 2 'no-such-folder' liver_models --cells 4 --steps 1 -o no-such-folder
expect 2 '--steps needs a whole number' liver_models --steps none

# ---- surface_to_sim ----
# cube FILE SIZE [SHIFT]: a closed box of 12 triangles with edges SIZE (m), in the middle at SHIFT
cube() {
    awk -v h="$2" -v s="${3:-0}" 'BEGIN {
        for (i = 0; i < 8; i++)
            print "v", s + h * (i % 2 - 0.5), h * (int(i / 2) % 2 - 0.5), h * (int(i / 4) - 0.5)
        n = split("1 3 4 2 5 6 8 7 1 2 6 5 3 7 8 4 1 5 7 3 2 4 8 6", f, " ")
        for (k = 1; k <= n; k += 4) {
            print "f", f[k], f[k + 1], f[k + 2]
            print "f", f[k], f[k + 2], f[k + 3]
        }
    }' >"$1"
}
# last NAME: the number behind NAME= on the last line
last() { tail -n 1 output.txt | tr ' ' '\n' | sed -n "s/^$1=//p"; }
holds() { awk "BEGIN { exit !($1) }"; }
cube box.obj 0.1
cube core.obj 0.04
cube far.obj 0.04 1
expect 0 'usage: surface_to_sim' surface_to_sim --help
expect 0 '^tets=[0-9]* min_dihedral=[0-9.]* max_dihedral=[0-9.]* distance=[0-9.e-]* seconds=[0-9.]*$' \
    surface_to_sim box.obj --cells 10 --steps 3 -o box.vtk --mesh volume.vtk
check "angles of the tets" holds "$(last min_dihedral) > 9 && $(last max_dihedral) < 165.7"
check "the mesh keeps to the surface" holds "$(last distance) < 0.01 / 3"
check "the mesh has the tets" grep -q "^CELLS $(last tets) " volume.vtk
check "the surface is carried along" grep -q '^VECTORS displacement' box.vtk
check "with normals" grep -q '^VECTORS normal' box.vtk
check "with stress" grep -q '^SCALARS von_mises' box.vtk
expect 0 '^tets=' surface_to_sim box.obj core.obj --cells 10 --steps 2 --mesh regions.vtk
check "the core is a region" grep -q '^1$' regions.vtk
for method in --sparse $(long echo --wc --fc); do
    expect 0 '^cells=' surface_to_sim box.obj core.obj $method --cells 8 --steps 2 --mesh grid.vtk
    check "$method writes bricks" grep -q '^12$' grid.vtk
done
sed '$d' box.obj >open.obj
expect 2 'open.obj: .* 3 edges of one face only; the first joins nodes' surface_to_sim open.obj
expect 0 'warning: repaired: .*1 holes filled' surface_to_sim open.obj --repair --cells 8 --steps 1
awk '/^f/ && !done { print $1, $2, $4, $3; done = 1; next } { print }' box.obj >turned.obj
expect 2 'turned.obj: .*oriented against each other' surface_to_sim turned.obj
for method in --stuff --wc; do
    expect 2 'far.obj: encloses no part of the body' surface_to_sim box.obj far.obj $method --cells 8 --steps 0
done
expect 2 'no-such.obj' surface_to_sim no-such.obj
expect 2 'SURFACE is missing' surface_to_sim --cells 10
expect 2 'only one of them' surface_to_sim box.obj --wc --fc
expect 2 'needs -x, +x' surface_to_sim box.obj --hold up
expect 2 'would be overwritten' surface_to_sim box.obj -o ./box.obj
expect 2 '--tet10 is for tets, not for grids' surface_to_sim box.obj --wc --tet10
expect 2 '--coarsen is for tets, not for grids' surface_to_sim box.obj --sparse --coarsen 1
expect 0 'box.obj: warning: 8 of its 8 vertices lie outside core.obj' surface_to_sim core.obj box.obj --cells 8 --steps 0
awk '/^v/ { $4 = 0 } { print }' box.obj >flat.obj
awk '/^v/ { $4 *= 0.01 } { print }' box.obj >thin.obj
expect 2 'that is --cells 150' surface_to_sim thin.obj --cells 9
expect 2 'flat.obj: is flat: it encloses nothing' surface_to_sim flat.obj --repair
expect 0 'warning: [0-9]* tets are turned inside out' surface_to_sim box.obj --young 20 --hold -z --cells 6 --steps 60
expect 0 '^tets=' surface_to_sim box.obj --cells 6
check "a hanging box is sound" eval '! grep -q warning output.txt'
expect 2 'no-such-folder' surface_to_sim box.obj --cells 4 --steps 1 -o no-such-folder/x.vtk
awk 'BEGIN {
    print "# vtk DataFile Version 3.0\nlabels (mm)\nASCII\nDATASET STRUCTURED_POINTS\nDIMENSIONS 14 14 14\nSPACING 8 8 8"
    print "ORIGIN -52 -52 -52\nPOINT_DATA 2744\nSCALARS label unsigned_char 1\nLOOKUP_TABLE default"
    for (i = 0; i < 2744; i++) {
        x = i % 14 - 6.5; y = int(i / 14) % 14 - 6.5; z = int(i / 196) - 6.5
        r = x * x + y * y + z * z
        print (r > 36 ? 0 : r > 6 ? 1 : 4)
    }
}' >labels.vtk
expect 0 '^kept .* % of the surface of label 4$' \
    surface_to_sim labels.vtk --scale 0.001 --cells 12 --steps 2 -o box.vtk --mesh regions.vtk
check "a label is a region" grep -q '^1$' regions.vtk
expect 0 '^tets=' surface_to_sim labels.vtk --scale 0.001 --label 1 --cells 12 --steps 0
expect 0 '^cells=' surface_to_sim labels.vtk --scale 0.001 --label 1,4 --wc --cells 8 --steps 0
expect 2 'no voxel of the image has one of them' surface_to_sim labels.vtk --label 7
expect 2 'needs whole numbers' surface_to_sim labels.vtk --label 1,x
expect 2 'is for label images' surface_to_sim box.obj --label 1
sed '20,$d' labels.vtk >cut.vtk
expect 2 "cut.vtk:[0-9]*: .*too short" surface_to_sim cut.vtk
for surface in liver_a liver_b bunny torus; do
    expect_data 0 '^tets=' surface_to_sim surfaces/$surface.obj --cells 20 --steps 2
done

# ---- cylinder_study ----
long expect 0 'study.svg written' cylinder_study --quick -o study
long check "no progress bar in a log" eval '! tr "\r" "@" <output.txt | grep -q @'
long check "30 rows and a head of CSV" eval '[ "$(wc -l <study.csv | tr -d " ")" = 31 ]'
long check "a chart of two panels" eval '[ "$(grep -c "relative L2 error" study.svg)" = 2 ]'
# the first size of the weighted cell is within 5 % of the displacement from the finite cell's error
long check "weighted cells are near finite cells" awk -F, '
    $2 == "finite cell 2" { fc[$1 $3] = $5 }
    $2 == "weighted cell 2" { d = $5 - fc[$1 $3]; if (d > 0.05 || d < -0.05) bad = 1; n++ }
    END { exit !(n == 4 && !bad) }' study.csv
expect 0 '^cylinder_study \[OPTIONS\]' cylinder_study --help
expect 2 '--steps needs a whole number' cylinder_study --steps 0
expect 2 'no-such-case' cylinder_study --quick no-such-case
expect 2 'no-such-folder' cylinder_study --quick -o no-such-folder/study

# ---- umesh: a network from data to errors ----
beam='--along 8 --samples 10'
expect 0 '^generate: 10 samples, shard 1 of 1, 10 to do' umesh generate beam.csv $beam
for shard in 1 2; do expect 0 "shard $shard of 2, 5 to do" umesh generate beam.$shard $beam --shard $shard/2; done
check "shards of samples are merged" sh "$here/../examples/study/merge.sh" beams.csv beam.1 beam.2
check "to the same bytes" cmp -s beams.csv beam.csv
expect 0 '^beam.sbnet written' umesh train beam.csv beam.sbnet $beam --channels 2 --epochs 3
expect 0 'trained: 8 samples, 3 epochs' umesh train beam.csv again.sbnet $beam --channels 2 --epochs 3
check "training twice gives the same weights" cmp -s beam.sbnet again.sbnet
expect 0 '^relative error: median .* of 2 samples' umesh evaluate beam.csv beam.sbnet $beam -o errors
check "starts from a network are compared" grep -q '^starts: 2 solves' output.txt
check "a chart, its numbers and a picture" eval 'grep -q "relative error" errors.svg && [ "$(wc -l <errors.csv | tr -d " ")" = 3 ] &&
    is_png errors.png'
expect 0 '^trained in' umesh all $beam --channels 2 --epochs 3 -o again
check "weights and a picture of all at once" eval 'is_png again.png && [ -s again.sbnet ]'
expect 0 '^targets: median .* mm' umesh all --organ box.obj $beam --channels 1 --epochs 1 -o cube
expect 2 'is no surface of triangles' umesh all --organ volume.vtk $beam
expect 2 'no-such.obj' umesh all --organ no-such.obj $beam
expect 0 '^umesh generate DATA' umesh --help
expect 2 'must be generate, train, evaluate or all' umesh
expect 2 'is none of generate' umesh guess beams.csv
expect 2 'needs DATA and WEIGHTS' umesh train beams.csv
expect 2 'needs a multiple of 8' umesh generate x.csv --along 12
expect 2 'has not all samples' umesh train beams.csv x.sbnet $beam --seed 5
expect 2 'no-such-file' umesh train no-such-file.csv x.sbnet $beam
expect 2 'are not the bytes of a weights file' umesh evaluate beams.csv beams.csv $beam
expect 0 'generate: 5 samples' umesh generate wide.csv --along 16 --samples 5
expect 2 'is of another lattice' umesh evaluate wide.csv beam.sbnet --along 16 --samples 5
expect 2 'no-such-folder' umesh train beams.csv no-such-folder/x $beam --channels 1 --epochs 1
expect 2 'no-such-folder' umesh evaluate beams.csv beam.sbnet $beam -o no-such-folder/x

# ---- particles_study ----
long expect 0 'particles.svg written' particles_study --quick --steps 3 -o particles
long check "two tables of 5 rows, 9 beams and a head of CSV" eval '[ "$(wc -l <particles.csv | tr -d " ")" = 20 ]'
long check "a chart of two panels" eval '[ "$(grep -c "particles or nodes" particles.svg)" = 1 ]'
# beams of grids of eight points bend within 8 % of the elements', of ten monomials within 3 %
long check "beams of particles bend as they should" awk -F, '
    $2 == "grid 8 points linear" { d = $4 / 44.946 - 1; if (d > 0.08 || d < -0.08) bad = 1; n++ }
    $2 == "grid 8 points quadratic" { d = $4 / 44.946 - 1; if (d > 0.03 || d < -0.03) bad = 1; n++ }
    END { exit !(n == 3 && !bad) }' particles.csv
expect 0 '^particles_study \[OPTIONS\]' particles_study --help
expect 2 '--steps needs a whole number' particles_study --steps 0
expect 2 'is one word too many' particles_study beam.vtk
expect 2 'no-such-folder' particles_study --quick -o no-such-folder/particles

# ---- needle_prostate ----
header='t,tip_x,tip_y,tip_z,base_fx,base_fy,base_fz,base_torque,static,dynamic,trials,iterations,quality,min_dihedral'
summary='^steps=200 median_ms=[0-9.]* p99_ms=[0-9.]* consistent=[0-9.]*% quality=[0-9.]* topology=restored$'
count_files() { ls $1 2>/dev/null | wc -l | tr -d ' '; }
# the mesh is the original one at the end, the tip went in and came back, and the force turned round
insertion() {
    awk -F, 'NR == 2 { start = $2 } NR > 1 { if ($2 > deepest || NR == 2) deepest = $2; if ($5 > push) push = $5
                                             if ($5 < pull) pull = $5; end = $2 }
             END { exit !(deepest > start + 0.015 && end < start && push > 0.3 && pull < -0.01) }' "$1"
}
expect 0 '^usage: needle_prostate' needle_prostate --help
mkdir -p needle
expect 0 "$summary" needle_prostate --seconds 4 --csv needle/a.csv -o needle/a
check "the summary is the last line" eval "tail -n 1 output.txt | grep -q '$summary'"
check "nothing stood in its way" eval '! grep -q warning output.txt'
check "the columns of the CSV" [ "$(head -n 1 needle/a.csv)" = "$header,max_dihedral,ms" ]
check "a line for each step" [ "$(wc -l <needle/a.csv | tr -d ' ')" = 201 ]
check "the needle went in and out" insertion needle/a.csv
check "9 frames of the tissue" [ "$(count_files 'needle/a_[0-9]*.vtk')" = 9 ]
check "9 frames of the needle" [ "$(count_files 'needle/a_needle_*.vtk')" = 9 ]
for field in 'VECTORS displacement' 'SCALARS region' 'SCALARS quality'; do
    check "the tissue has $field" grep -a -q "^$field " needle/a_0008.vtk
done
check "the needle is a line" grep -q '^LINES 1 ' needle/a_needle_0004.vtk
check "that slips" grep -q '^[23]$' needle/a_needle_0004.vtk
check "lists of both" [ "$(cat needle/a.vtk.series needle/a_needle.vtk.series | grep -c '"name": "a_')" = 18 ]
check "a chart" grep -q '</svg>' needle/a.svg
check "a picture" is_png needle/a.png
long expect 0 "$summary" needle_prostate --seconds 4 --tip symmetric --csv needle/b.csv -o needle/b
long check "a symmetric tip goes in and out" insertion needle/b.csv
expect 0 'sags' hello needle/a_0008.vtk
if [ -n "$data" ]; then
    long expect 0 "$summary" needle_prostate --mesh "$data/phantom/phantom_tet4.vtk" --seconds 4 --csv needle/c.csv \
        -o needle/c
    long check "into the phantom and out" insertion needle/c.csv
    expect 2 'must be a volume of tets with 4 nodes' needle_prostate --mesh "$data/surfaces/liver_a.obj" -o needle/d
    expect 2 'must be a volume of tets with 4 nodes' needle_prostate --mesh "$data/phantom/phantom_tet10.vtk" -o needle/d
    expect 2 'nan_coordinate.vtk:9: ' needle_prostate --mesh "$data/bad/nan_coordinate.vtk" -o needle/d
else
    skip "no data: needle_prostate --mesh"
fi
long expect 0 '^steps=50 .*consistent=100' needle_prostate --anatomy --seconds 1 -o needle/e
long expect 0 "$summary" needle_prostate --anatomy --seconds 4 --csv needle/f.csv -o needle/f
long check "through skin and out" insertion needle/f.csv
expect 0 '^steps=100 .*consistent=100.*topology=kept' needle_prostate --anatomy --lesion --seconds 2 -o needle/h
expect 2 '--lesion goes with --anatomy' needle_prostate --lesion
expect 2 'does not go with --mesh' needle_prostate --anatomy --mesh needle/a_0000.vtk
expect 2 'no-such-file.vtk' needle_prostate --mesh no-such-file.vtk
expect 2 '--mesh needs a value' needle_prostate --mesh
expect 2 '--tip needs bevel or symmetric' needle_prostate --tip sharp
expect 2 '--seconds needs a number from' needle_prostate --seconds 0
expect 2 '--seconds needs a number from' needle_prostate --seconds long
expect 2 '--depth is no option' needle_prostate --depth 3
expect 2 'a.vtk is one word too many' needle_prostate a.vtk
expect 2 'no-such-folder/x.csv cannot be written' needle_prostate --seconds 1 --csv no-such-folder/x.csv -o needle/d
expect 2 'no-such-folder/x_0000.vtk' needle_prostate --seconds 1 -o no-such-folder/x
expect 2 'would be overwritten' needle_prostate --mesh needle/a_0000.vtk --csv needle/a_0000.vtk

# ---- one_body ----
expect 0 '^usage: one_body' one_body --help
mkdir -p one
one_body_whole() {
    expect 0 '^registered_mm=0\.[0-2].* open_edges=0 continued=same replayed=same needle=out' one_body --cells 10 --steps 30 -o one/a
    check "the organ and its target are found" awk '/^registered_mm/ { split($2, t, "="); split($3, m, "=")
        exit !(t[2] < 3 && m[2] < 5) }' output.txt
    check "it is cut open, and the grasper carries the flap" awk '/^registered_mm/ { split($5, a, "="); split($6, f, "=")
        exit !(a[2] > 2000 && a[2] < 3200 && f[2] > 0.1 && f[2] < 10) }' output.txt
    check "the flap lies on the retractor, and the needle's way is open" awk '/^registered_mm/ { split($7, h, "=")
        split($8, g, "="); exit !(h[2] > 0.2 && h[2] < 5 && g[2] > 1 && g[2] < 10) }' output.txt
    check "so it does when the grasper has let go, and when the needle is drawn out" awk -F, 'NR > 1 && $5 > 0 { carried = 1 }
        carried && $5 == 0 { let_go++ } let_go > 20 && $6 < low { low = $6 } { last = $6 } BEGIN { low = 1 }
        END { exit !(low > 0.1 && last > 0.1) }' one/a.csv
    check "a picture" is_png one/a.png
    check "the probe presses, and is lifted" awk -F, 'NR > 1 && $4 == 0 && $3 > high { high = $3 } { last = $3 }
        END { exit !(high > 0.29 && high < 0.6 && last == 0) }' one/a.csv
    check "the hand pushes, and pulls" awk -F, 'NR > 1 && $2 > high { high = $2 } NR > 1 && $2 < low { low = $2 }
        END { exit !(high > 0.1 && low < -0.1) }' one/a.csv
}
long one_body_whole
expect_data 2 'nan_coordinate.vtk:9: ' one_body bad/nan_coordinate.vtk --mesh
expect_data 2 'must be a volume mesh of tets with 4 nodes' one_body volumes/liver_a_tet10_1k.vtk --mesh
expect_data 2 'see --scale' one_body volumes/liver_a_tet4_2k.vtk --scale 1e-6 --mesh
expect 3 "the organ lies .* mm from its scan, over --limit 0.01" one_body --cells 6 --steps 3 --limit 0.01 -o one/far
expect 4 "the tip rests .* mm from it, over --miss 0.001" one_body --cells 6 --steps 3 --miss 0.001 --press 100 -o one/bad
check "the probe presses too weakly" grep -q 'it presses with .* N, not --press 100' output.txt
check "it opens so coarse an organ, too" awk '/^registered_mm/ { split($7, h, "="); exit !(h[2] > 0.2) }' output.txt
expect 2 'no-such.ply' one_body --cells 6 --scan no-such.ply
expect 2 'no-such.obj' one_body --skin no-such.obj
expect 2 '--cells needs a whole number' one_body --cells 2
expect 2 'no-such-folder/x.csv' one_body --cells 6 -o no-such-folder/x

# ---- needle_forces ----
expect 0 'usage: needle_forces' needle_forces --help
expect 0 '^lateral *forces_lateral.svg, forces_lateral.csv' needle_forces -o forces
check "it slips at friction times depth, either way" awk '
    /^sticks, slips/ { low = -$4; high = $6; limit = $12 } END { exit !(high > limit && high < 1.4 * limit &&
    low > limit && low < 1.4 * limit) }' output.txt
check "skin and capsule break at what they hold" awk '
    /^skin, capsule/ { exit !($5 > 3.15 && $5 < 3.4 && $7 > 2.2 && $7 < 2.5 && $9 < 0.5) }' output.txt
check "faster is harder, and still is easy" awk '
    /^viscous/ { if ($4 * 1.5 < $5 && $5 * 1.5 < $7 && $9 < 0.05) good = 1 } END { exit !good }' output.txt
for name in stick_slip puncture viscous lateral; do
    check "$name: a chart" grep -q '</svg>' forces_$name.svg
    check "$name: numbers" [ "$(awk -F, 'NF == 5' forces_$name.csv | wc -l)" -gt 150 ]
done
expect 2 '--friction needs a number from' needle_forces --friction -1
expect 2 '--young needs a number from' needle_forces --young nan
expect 2 '--speed is no option' needle_forces --speed 1
expect 2 'hard is one word too many' needle_forces hard
expect 2 'cannot be written' needle_forces -o no-such-folder/x

# ---- needle_control ----
expect 0 '^usage: needle_control' needle_control --help
expect 0 '^targets=4 hit=4 within_mm=1.0 median_mm=[0-9.]* max_mm=[0-9.]* seconds=[0-9.]*$' \
    needle_control --targets 4 -o control
check "a row for each target" [ "$(wc -l <control.csv | tr -d ' ')" = 5 ]
check "the first insertion is told" grep -q "first insertion: the tip's way is a circle of 1[0-9][0-9]" output.txt
cp control.csv first.csv
if is_whole; then
    expect 0 'hit=4' needle_control --targets 4 --quiet -o control
    check "the same targets again" cmp -s control.csv first.csv
fi
long expect 0 '^targets=3 hit=3' needle_control --push --targets 3 --seed 3
long expect_data 0 '^targets=2 hit=2' needle_control phantom/phantom_tet4.vtk --targets 2 --mesh
expect 2 '--targets needs a whole number' needle_control --targets 0
expect 2 '--error needs a number from 0 to 0.5' needle_control --error 2
expect 2 'aim is one word too many' needle_control aim
expect 2 'no-such.vtk: the file cannot be opened' needle_control --mesh no-such.vtk
expect_data 2 'nan_coordinate.vtk:9: ' needle_control bad/nan_coordinate.vtk --mesh
expect_data 2 'needles need a volume mesh of tet4' needle_control volumes/liver_a_tet10_1k.vtk --mesh
expect_data 2 'see --scale' needle_control volumes/liver_a_tet4_2k.vtk --scale 0.001 --mesh
expect 2 'no-such-folder/x.csv cannot be written' needle_control -o no-such-folder/x

# ---- viewer ----
# Without a screen; a session by hand is played, recorded anew with the bits that it leads to, and played from there.
if [ -e "$programs/viewer" ]; then
    SDL_VIDEODRIVER=dummy SDL_RENDER_DRIVER=software && export SDL_VIDEODRIVER SDL_RENDER_DRIVER
    printf '%s\n' 'viewer 1' 'organ 231 960' 'start 1 8000 0.45 0.02' '2 pull 0.1 -1 0.05 0 1 0' '3 move 0.1 -1 0.09 0 1 0' \
        '12 release' '14 set 0 3000' '20 pierce 0.1 -1 0.05 0 1 0' '32 out 1' '36 out 0' '40 gravity 0' '44 end 1' >by_hand
    expect 0 '^usage: viewer' viewer --help
    organ=$("$programs/viewer" --cells 6 --frames 1 --record size >size.txt 2>&1 && sed -n 2p size)
    sed "s/^organ.*/$organ/" by_hand >other_bits
    expect 1 'played=other bits' viewer --cells 6 --frames 45 --play other_bits --record session
    expect 0 '^frames=44 .* played=same bits' viewer --cells 6 --frames 45 --play session --picture viewer.png
    check "a session has every event" [ "$(grep -c '' session)" = "$(grep -c '' by_hand)" ]
    check "viewer draws" sh -c 'head -c 8 viewer.png | grep -q PNG && [ "$(wc -c <viewer.png)" -gt 20000 ]'
    expect 0 'played=in part' viewer --cells 6 --frames 20 --play session
    expect 0 '^frames=3 force_N=0 ' viewer --cells 4 --frames 3 --hold z-
    expect 2 'another organ' viewer --cells 5 --frames 1 --play session
    sed 's/gravity 0/gravity/' session >session.bad
    expect 2 'session.bad:11: numbers that' viewer --cells 6 --frames 1 --play session.bad
    sed 's/gravity 0/jump 3/' session >session.bad
    expect 2 'session.bad:11: an event that is not known' viewer --cells 6 --frames 1 --play session.bad
    sed 's/^14 set 0 3000/14 set 9 3000/' session >session.bad
    expect 2 'session.bad:7: numbers that' viewer --cells 6 --frames 1 --play session.bad
    sed '$d' session >session.bad
    expect 2 'session.bad:12: the file ends before' viewer --cells 6 --frames 1 --play session.bad
    sed 's/^20 pierce/1 pierce/' session >session.bad
    expect 2 'session.bad:8: not a frame, after' viewer --cells 6 --frames 1 --play session.bad
    expect 2 'is no session of viewer' viewer --cells 6 --frames 1 --play size.txt
    expect 2 'no-such.vtk' viewer no-such.vtk
    expect 2 'no-such: cannot be read' viewer --cells 4 --play no-such
    expect 2 'no-such-folder/x: cannot be written' viewer --cells 4 --frames 1 --record no-such-folder/x
    expect 2 '--hold needs' viewer --hold w+
    expect 2 '--picture needs --frames' viewer --picture x.png
    expect_data 0 '^frames=5 ' viewer volumes/liver_a_tet4_2k.vtk --frames 5
    expect_data 0 '^frames=2 ' viewer volumes/liver_a_tet10_1k.vtk --frames 2
    expect_data 0 '^frames=2 ' viewer volumes/beam_hex8.vtk --frames 2
else
    skip "no SDL 2: viewer"
fi

# ---- needle_obstacles ----
expect 0 '^usage: needle_obstacles' needle_obstacles --help
expect 0 '^reached=1 distance_mm=0[0-9.]* clearance_mm=[0-9.]* steps=[0-9]* median_ms=[0-9.]* seconds=[0-9.]*$' \
    needle_obstacles
check "the margin is kept to a tenth" holds "$(last clearance_mm) > 0.9 * 2"
check "the straight way is barred" grep -q 'on the straight way .* inside of a cylinder' output.txt
check "obstacles.png is a picture" is_png obstacles.png
check "the table has a row for each step" [ "$(wc -l <obstacles.csv | tr -d ' ')" = "$(($(last steps) + 1))" ]
check "the tissue has its displacements" grep -q '^VECTORS displacement' obstacles.vtk
long expect 1 '^reached=0' needle_obstacles --radius 1
long expect_data 0 '^reached=1' needle_obstacles phantom/phantom_tet4.vtk -o organ --within 1 --mesh
expect 2 'no-such.vtk' needle_obstacles --mesh no-such.vtk
expect 2 '--cylinder needs a number' needle_obstacles --cylinder wide
expect 2 'no-such-folder/x.csv' needle_obstacles -o no-such-folder/x

# ---- needle_phantom ----
expect 0 '^usage: needle_phantom' needle_phantom --help
expect 0 '^markers=16 single_rms_mm=.* double_radius_mm=[0-9.]*,[0-9.]* .*topology=restored seconds=[0-9.]*$' \
    needle_phantom --cells 12 --markers 4
check "the path is nearly that in rigid gel" holds "$(last single_radius_mm) > 145 && $(last single_radius_mm) < 175"
check "to a share of a percent" holds "$(last single_deviation_mm) < 0.5"
check "both bends are pictured" eval 'is_png phantom_single.png && is_png phantom_double.png'
check "a chart of three panels" [ "$(grep -c '<g transform' phantom.svg)" = 3 ]
check "markers have their rows" [ "$(awk -F, '$3 == 15' phantom_double.csv | wc -l)" -gt 20 ]
long expect 0 'single_error_mm=0.000 .*single_under_1mm=1.000' \
    needle_phantom --cells 12 --markers 4 --bend single --truth phantom -o again
long expect 0 'single_error_mm=0\.[1-9][0-9]* .*single_under_2mm=1.000' \
    needle_phantom --cells 12 --markers 4 --bend single --held --truth phantom -o held
long expect 0 '^single bend: RMS of the markers' needle_phantom --cells 8 --markers 4 --bend single --truth phantom -o off --every 5 --sensitivity
expect 2 '--sensitivity needs a --truth' needle_phantom --sensitivity
expect 2 'no-such_single.csv: cannot be opened' needle_phantom --truth no-such
expect 2 'has no rows of these markers' needle_phantom --truth phantom --markers 5 -o five
expect 2 'names the files that -o writes' needle_phantom --truth phantom
long expect 0 '^markers=9 double_rms_mm=' needle_phantom --bend double --cells 8 --markers 3 --depth 0.08 -o short
long expect_data 0 '^markers=[0-9]* single' needle_phantom phantom/phantom_tet4.vtk --bend single --depth 0.06 -o organ --mesh
expect 2 'triple is no bend' needle_phantom --bend triple
expect 2 'is too short for --depth' needle_phantom --depth 0.3
expect 2 'no-such.vtk' needle_phantom --mesh no-such.vtk
expect 2 'no-such-folder/x_single.csv' needle_phantom -o no-such-folder/x

# ---- grasp ----
expect 0 '^usage: grasp' grasp --help
expect 0 '^slipped=1 pull_out_N=[0-9.]* mu_N=[0-9.]* ratio=[0-9.]* steps=[0-9]* median_ms=[0-9.]*$' grasp --every 20
check "it slips out when friction is used up" holds "$(last ratio) > 0.93 && $(last ratio) < 1.07"
check "grasp.png is a picture" is_png grasp.png
check "a chart of three panels" [ "$(grep -c '<g transform' grasp.svg)" = 3 ]
check "the table has a row for each step" [ "$(wc -l <grasp.csv | tr -d ' ')" = "$(($(last steps) + 1))" ]
check "the series names its files" [ "$(grep -c '"name": "grasp_00' grasp.vtk.series)" = "$(($(last steps) / 20))" ]
pull=$(last pull_out_N)
if is_whole; then
    expect 0 '^slipped=1' grasp --mu 0.15 -o slippery
    check "half the friction pulls half as much" holds "$(last pull_out_N) < 0.7 * $pull && $(last pull_out_N) > 0.35 * $pull"
fi
long expect 0 'it held; take a longer --way' grasp --way 0.002 -o held
long expect_data 0 '^slipped=1' grasp volumes/liver_a_tet4_2k.vtk -o organ --young 5000 --poisson 0.45
expect 2 '--mu needs a number from 0 to' grasp --mu -1
expect 2 '--speed needs a number from' grasp --speed nan
expect 2 '--held: would hold what is between the jaws' grasp --held 0.9
expect 2 'of a jaw needs to be less than' grasp --length 0.001
expect 2 '--squish is no option' grasp --squish 1
expect 2 'b.vtk is a second file' grasp a.vtk b.vtk
expect 2 'no-such.vtk' grasp no-such.vtk
expect_data 2 'nan_coordinate.vtk:9: ' grasp bad/nan_coordinate.vtk
expect_data 2 'is a surface' grasp surfaces/liver_a.obj
expect_data 2 'add --scale 0.001' grasp volumes/liver_a_tet4_2k.vtk --scale 1000
expect 2 'no-such-folder/x.csv: cannot be written' grasp --way 0.001 -o no-such-folder/x

# ---- identify ----
expect 0 '^usage: identify' identify --help
expect 0 '^core of 21.9 mm' identify -o moduli
check "moduli.svg is a chart" grep -q '</svg>' moduli.svg
long expect 0 '^shell: [34][0-9]* Pa, deviation' identify moduli.txt -o again
long expect 0 'believe neither value alone' identify --force -o force
echo 'depth 0.004 1 2' >short.txt
expect 2 'holds no readings' identify short.txt
sed '12,$s/^marker 2/marker 1/' moduli.txt >others.txt
expect 2 'holds no readings' identify others.txt
sed '$s/[^ ]*$/0/' moduli.txt >certain.txt
expect 2 'holds no readings' identify certain.txt
sed 's/^depth 0.004 [^ ]*/depth 0.004 nan/' moduli.txt >unread.txt
expect 2 'holds no readings' identify unread.txt
cat moduli.txt short.txt >more.txt
expect 2 'holds no readings' identify more.txt
expect 2 'cannot be read' identify no-such-file.txt
expect 2 'no-such-folder/x.txt cannot be written' identify -o no-such-folder/x
expect 2 '--size needs a number' identify --size 0.006
expect 2 '--size needs a number' identify --size 0.045
expect 2 '--noise needs a number' identify --noise -1
# of a model whose moduli are half and twice what they were when it was "measured", in two states
sed -e 's/^1E7, 4.8E-8/5E6, 9.6E-8/' -e 's/^3E7, 1E7, 2E-8/6E7, 2E7, 1E-8/' "$tests/block.inp" >seek.inp
expect 0 'converged' case_solve "$tests/block.inp" -p seen_
expect 0 '^value 0: Young.s modulus of region 3 5172.41 Pa from 2586.21, .* share 0' identify seek.inp seen_displacement.txt --young all
check "and the other's" grep -q '^value 1: Young.s modulus of region 5 15000 Pa from 30000' output.txt
echo 'output reaction reaction.txt' >>block.case
expect 0 'converged' case_solve block.case -p first_
sed -e 's/ value=100$/ value=250/' -e 's/^gravity .*/spring file=hook.txt/' block.case >pressed.case
echo '35 5 0.03 0.02 0.03' >hook.txt
expect 0 'converged' case_solve pressed.case -p second_
printf '%s\n' 0 4 8 12 16 20 24 28 32 >base.txt
awk 'NR == FNR { base[$1] = 1; next } base[$1] { x += $2; y += $3; z += $4 }
    END { printf "# of the base\r\nsigma 1e-5\nforce base.txt %.9g %.9g nan 0.01\n", x, y }' base.txt first_reaction.txt >force.txt
{ cat force.txt && sed -n '10,20p' first_displacement.txt; } >first.txt
for file in block pressed; do
    sed 's/C10=1000 D1=0.00048[0-9]*/C10=2000 D1=0.00024/' $file.case >seek_$file.case
done
expect 0 '^value 0: Young.s modulus of region 3 5172.4[0-9]* Pa from 10344.8, .* share 1.000' \
    identify seek_block.case first.txt seek_pressed.case second_displacement.txt --young 3
check "forces and places are counted" grep -q '^chi2 [0-9.e-]* of 143 readings' output.txt
expect 0 'nearer than their sigmas say' identify seek_block.case first_displacement.txt --young 3
expect 2 'has no region 4' identify seek_block.case first.txt --young 4
expect 2 'or region 3 twice' identify seek_block.case first.txt --young 3,3
expect 2 'is no list of regions' identify seek_block.case first.txt --poisson 3,
expect 2 'nothing is sought' identify seek_block.case first.txt
expect 2 'needs its readings' identify seek_block.case --young 3
expect 2 'is not that of the first' identify seek_block.case first.txt "$tests/column.inp" first.txt --young 3
expect 2 'first.txt is no case' identify first.txt seek_block.case
expect 2 'no-such.case' identify no-such.case first.txt --young 3
expect 2 'no-such.txt' identify seek_block.case no-such.txt --young 3
expect 2 'mistakes.inp:8: elements C3D8R' identify "$tests/mistakes.inp" first.txt --young 3
sed 's/^solve .*/solve euler dt=0.1 end=1/' block.case >moving.case
expect 2 'sought in static solves' identify moving.case first.txt --young 3
refused() { # refused WORDS LINE: a reading that is none
    echo "$2" >wrong.txt
    expect 2 "wrong.txt:1: $1" identify seek_block.case wrong.txt --young 3
}
refused 'the line begins with no node' '36 0 0 0'
refused 'the line begins with no node' 'force'"'"'s 1'
refused 'a reading is NODE' '3 0 0'
refused 'a reading is NODE' '3 0 0 inf'
refused 'the line holds more' '3 0 0 0 0'
refused 'sigma needs metres' 'sigma 0'
refused 'a force is NODES' 'force base.txt 1 2 3 0'
refused 'No such file' 'force none.txt 1 2 3 1'
refused 'a line of the list is no node' 'force first.txt 1 2 3 1'
: >empty.txt
expect 2 'empty.txt: it holds no readings' identify seek_block.case empty.txt --young 3
echo '0 0 0 0' >seen_none.txt
expect 3 'no reading changes with value 0'  identify seek_block.case seen_none.txt --young 3

# ---- track_liver ----
expect 0 '^usage: track_liver' track_liver --help
expect 0 '^error_mm=[0-9.]* expected_mm=[0-9.]* blind_mm=[0-9.]* frame_ms=.* state=follows$' track_liver --seconds 4 --every 2
check "the organ is followed" holds "$(last error_mm) < 2"
check "the error to expect is of the size of the error" \
    holds "$(last expected_mm) > 0.5 * $(last error_mm) && $(last expected_mm) < 5 * $(last error_mm)"
check "a row for each frame" [ "$(wc -l <track_liver.csv | tr -d ' ')" = 121 ]
check "the chart has what is expected" grep -q '>expected<' track_liver.svg
printf -- '-0.0994 0 -0.0456\n0.0994 0 -0.0416 # the right lobe\n' >marks.txt
printf '0 -0.0177 -0.0662 -0.02\n0 0.03 -0.06 -0.02\n0 0.06 -0.04 -0.02\n1 -0.05 0 0\n1 0 0 0.01\n1 0.05 0 0\n' >curves.txt
# 1.0 to 1.1 mm without them, 0.52 to 0.54 with them
expect 0 '^error_mm=0\.[0-7]' track_liver --seconds 4 --landmarks marks.txt --curves curves.txt
echo '1 2' >bad.txt
expect 2 'bad.txt:1: not .x y z' track_liver --cells 10 --landmarks bad.txt
echo '3 0 0' >bad.txt
expect 2 'outside the mesh' track_liver --cells 10 --landmarks bad.txt
echo '1 0 0 0' >bad.txt
expect 2 'bad.txt:1: not .c x y z' track_liver --cells 10 --curves bad.txt
echo '0 0 0 0' >bad.txt
expect 2 'a line needs two corners' track_liver --cells 10 --curves bad.txt
track="track_liver --cells 10 --seconds 1 --points 200"
expect 4 'state=lost$' $track --seconds 2 --drop 1.5 --every 2 -o lost
expect_data 0 'state=follows$' track_liver volumes/liver_a_tet4_2k.vtk --seconds 1 --points 200 -o file
expect 2 '--modes needs a whole number from 1 to 96' track_liver --modes 0
expect 2 '--rate needs a number from' track_liver --rate 0
expect 2 'more than 20,000 frames' track_liver --cells 10 --seconds 600 --rate 100
expect 2 'through half of the organ' track_liver --cells 10 --push 0.2
expect 2 'fast is no option\|--fast is no option' track_liver --fast
expect 2 'no-such.vtk' track_liver no-such.vtk
expect_data 2 'is a surface' track_liver surfaces/liver_a.obj
expect 2 'no-such-folder/x.csv: cannot be written' $track -o no-such-folder/x

# ---- palpation ----
expect 0 '^usage: palpation' palpation --help
palpate="palpation --cells 10 --grid 9"
expect 0 '^seen=1 error_mm=[0-9.]* contrast=[0-9.]* over_noise=[0-9.]* points=81$' $palpate -o palpation
check "it is found where it is" holds "$(last error_mm) < 8"
check "palpation.png is a picture" is_png palpation.png
check "a row for each point" [ "$(wc -l <palpation.csv | tr -d ' ')" = 82 ]
for seed in $(long echo 1 2 3 4 5); do
    expect 0 '^seen=[01] error_mm=' $palpate --seed $seed
    check "seed $seed: it is found where it is" holds "$(last error_mm) < 8"
done
long expect 0 '^seen=1 error_mm=' $palpate --healthy --grid 7
long expect 0 '^seen=0' $palpate --ratio 1
long expect_data 0 '^seen=1' palpation volumes/liver_a_tet4_2k.vtk --healthy --size 0.015 --depth 0.018 --grid 9 -o organ
expect 2 '--grid needs a whole number from 5 to' palpation --grid 2
expect 2 '--ratio needs a number from' palpation --ratio 0
expect 2 'has no room there' palpation --depth 0.039
expect 2 'is smaller than an element' palpation --cells 4 --size 0.001
expect 2 'needs to be less than the probe' palpation --indent 0.02
expect 2 'hard is no option\|--hard is no option' palpation --hard
expect 2 'no-such.vtk' palpation no-such.vtk
expect_data 2 'is a surface' palpation surfaces/liver_a.obj
expect 2 'no-such-folder/x.csv: cannot be written' palpation --cells 6 --size 0.012 --grid 5 -o no-such-folder/x

# ---- register_liver ----
is_near() { # is_near MM FILE FILE: the displacements of two registrations, in their mean
    paste -d ' ' "$2" "$3" | awk -v most="$1" '!/^#/ { sum += sqrt(($2 - $6) ^ 2 + ($3 - $7) ^ 2 + ($4 - $8) ^ 2); n++ }
        END { exit !(n > 0 && 1e3 * sum / n < most) }'
}
expect 0 '^register_liver MODEL TARGET' register_liver --help
expect 2 'needs a MODEL and a TARGET' register_liver
expect 2 'nosuch is no option\|--nosuch' register_liver a b --nosuch
expect 2 'is no method' register_liver a b --method magic
expect 2 'go together' register_liver a b --targets t.txt
expect 2 'no-such-file.vtk' register_liver no-such-file.vtk no-such-file.obj
case_of_liver=$data/insilico/liver2
if [ -n "$data" ] && [ -e "$case_of_liver/coarse_tet4.vtk" ]; then
    awk '!/^#/ {print $2, $3, $4}' "$case_of_liver/landmarks_before.txt" >points.txt
    echo '0.70710678 0 0.70710678 -0.1' >fixed.txt
    last='^iterations=[0-9]* steps_per_second=[0-9.]* seconds=[0-9.]* distance_mm=[0-9.]* stop=[a-z_]*$'
    for method in $(long echo pbsm) nicp icp cpd; do
        expect 0 "$last" register_liver "$case_of_liver/coarse_tet4.vtk" "$case_of_liver/deformed_surface.obj" \
            --method $method --targets points.txt --targets-out seen.txt --displacement moved.txt -o registered.vtk
        check "$method: 10 targets" [ "$(grep -vc '^#' seen.txt)" = 10 ]
        check "$method: every node" [ "$(grep -vc '^#' moved.txt)" = 1972 ]
        check "$method: the model" grep -q '^VECTORS displacement' registered.vtk
    done
    paste -d ' ' points.txt points.txt | head -n 2 >pairs.txt
    expect 0 "$last" register_liver "$case_of_liver/coarse_tet10.vtk" "$case_of_liver/partial_deformed_surface.obj" \
        --method nicp --partial --fix fixed.txt --landmarks pairs.txt
    sure=' expected_mm=[0-9.]* expected_worst_mm=[0-9.]* prior=[a-z]*$'
    part_of_liver=$case_of_liver/partial_deformed_surface.obj
    expect 0 "${last%?}$sure" register_liver "$case_of_liver/coarse_tet4.vtk" "$part_of_liver" --method infer -o registered.vtk
    check "infer: the error to expect of each node" grep -q '^SCALARS expected' registered.vtk
    expect 4 'not to be trusted: the error to expect is above' register_liver "$case_of_liver/coarse_tet4.vtk" \
        "$part_of_liver" --method infer --limit 0.1
    expect 4 'a landmark at .* of the model would lower it most' register_liver "$case_of_liver/coarse_tet4.vtk" \
        "$part_of_liver" --method infer --limit 0.1
    expect 0 'not to be trusted: the error to expect is above' register_liver "$case_of_liver/coarse_tet4.vtk" \
        "$part_of_liver" --method infer --limit 0.1 --force
    expect 0 "^iterations=.* gas_pa=[-+.e0-9]*$sure" register_liver "$case_of_liver/coarse_tet4.vtk" "$part_of_liver" \
        --method infer --gas 0,0,1
    printf '# a vessel\n0 0 -0.045 0.052 0.017\n0 0 0.108 -0.003 0.032\n0 1 0.107 -0.003 0.031\n0 1 -0.045 0.053 0.013\n' >curves.txt
    expect 0 "${last%?}$sure" register_liver "$case_of_liver/coarse_tet4.vtk" "$part_of_liver" --method infer --curves curves.txt
    expect 2 'curves: goes with --method infer only' register_liver "$case_of_liver/coarse_tet4.vtk" "$part_of_liver" \
        --curves curves.txt
    printf '0 0 0 0 0\n0 2 0 0 0\n' >bad.txt
    expect 2 'bad.txt:2: not .c 0  x y z. or' register_liver "$case_of_liver/coarse_tet4.vtk" "$part_of_liver" --method infer \
        --curves bad.txt
    expect 2 'gas: goes with --method infer only' register_liver "$case_of_liver/coarse_tet4.vtk" "$part_of_liver" --gas 0,0,1
    expect 2 '0,0,0 is no direction' register_liver "$case_of_liver/coarse_tet4.vtk" "$part_of_liver" --method infer \
        --gas 0,0,0
    echo '1972' >bad.txt
    expect 2 'bad.txt:1: no node' register_liver "$case_of_liver/coarse_tet4.vtk" \
        "$case_of_liver/deformed_surface.obj" --fix bad.txt
    printf '\357\273\2770\n1\0002\n' >bad.txt # a byte order mark is no number, a NUL byte an error
    expect 2 'bad.txt:2: ' register_liver "$case_of_liver/coarse_tet4.vtk" "$case_of_liver/deformed_surface.obj" --fix bad.txt
    echo '1 2 x' >bad.txt
    expect 2 'bad.txt:1: not' register_liver "$case_of_liver/coarse_tet4.vtk" \
        "$case_of_liver/deformed_surface.obj" --landmarks bad.txt
    echo '5 5 5 0 0 0' >bad.txt # a landmark that is refused ends every match, the one that would follow without loads, too
    for how in pbsm 'pbsm --plain' nicp; do
        expect 3 'outside the mesh' register_liver "$case_of_liver/coarse_tet4.vtk" \
            "$case_of_liver/deformed_surface.obj" --method $how --landmarks bad.txt
    done
    echo '0.1 0.1 0.1' >point.xyz
    expect 2 'one place or line' register_liver "$case_of_liver/coarse_tet4.vtk" point.xyz
    awk 'BEGIN { for (i = 0; i < 400; i++) print 0.01 * (i % 20), 0.01 * int(i / 20), 0 }' >plane.xyz
    expect 2 'one plane' register_liver "$case_of_liver/coarse_tet4.vtk" plane.xyz
    awk 'BEGIN { for (i = 0; i < 400; i++) print 3 * sin(i), 3 * cos(3 * i), 3 * sin(7 * i) }' >ball.xyz
    expect 2 'are both in one unit' register_liver "$case_of_liver/coarse_tet4.vtk" ball.xyz
    awk 'BEGIN { for (i = 0; i < 60000; i++) print 0.1 * sin(i), 0.1 * cos(3 * i), 0.1 * sin(7 * i) }' >dense.xyz
    expect 3 'ambiguous: two poses.*--seen-from' register_liver "$case_of_liver/coarse_tet4.vtk" dense.xyz --method icp
    check "a dense cloud is thinned" grep -q '60000 points, thinned to' output.txt
    expect 4 'warning: ambiguous' register_liver "$case_of_liver/coarse_tet4.vtk" dense.xyz --method icp --any
    # which way the target faces
    part=$case_of_liver/partial_deformed_surface.obj model=$case_of_liver/coarse_tet4.vtk
    awk '$1 == "f" {t = $2; $2 = $3; $3 = t} {print}' "$part" >turned.obj
    awk '$1 == "v" {print $2, $3, $4}' "$part" >bare.xyz
    expect 2 'seen-from 1,2: not X,Y,Z' register_liver "$model" bare.xyz --partial --seen-from 1,2
    awk '$1 == "v" {$2 += 8} {print}' "$part" >away.obj
    expect 3 'some 8.* m from the model: it is not in' register_liver "$model" away.obj --aligned --method nicp
    awk '$1 == "v" {$2 *= 1.8; $3 *= 1.8; $4 *= 1.8} {print}' "$case_of_liver/deformed_surface.obj" >large.obj
    expect 4 "warning: scale: the target's size" register_liver "$model" large.obj --method icp --any
    expect 2 'camera 1,2: not X,Y,Z' register_liver "$model" bare.xyz --partial --camera 1,2
    expect 2 'a camera sees no back' register_liver "$model" "$case_of_liver/deformed_surface.obj" --camera -0.2,-1,0.6
    expect 4 'not to be trusted: cut off by its time' register_liver "$model" "$part" --method nicp --seconds 0.001
    expect 0 "$last" register_liver "$model" "$part" --method nicp --displacement right.txt --picture registered.png
    check "registered.png is a picture" is_png registered.png
    expect 2 'no-such-folder' register_liver "$model" "$part" --method nicp --picture no-such-folder/x.png
    expect 0 'turned.obj: its normals point inwards: turned' register_liver "$model" turned.obj --method nicp \
        --displacement turned.txt
    check "a target inside out gives nearly what it gives as it is" is_near 2 right.txt turned.txt
    expect 0 'turned.obj: its normals point inwards: turned' register_liver "$model" turned.obj --method nicp \
        --aligned --camera -0.2,-1,0.6
    expect 0 "$last" register_liver "$model" bare.xyz --partial --camera -0.2,-1,0.6 --method nicp --displacement bare.txt
    check "points and a camera give nearly what the surface gives" is_near 6 right.txt bare.txt # the wrong side: 26 and more
    expect 0 "$last" register_liver "$model" bare.xyz --partial --seen-from -0.2,-1,0.6 --method nicp --displacement bare.txt
    check "points alone, too" is_near 6 right.txt bare.txt
    expect 2 'is a volume' register_liver "$case_of_liver/coarse_tet4.vtk" "$case_of_liver/coarse_tet4.vtk"
    expect 2 'cannot be opened' register_liver "$case_of_liver/coarse_tet4.vtk" \
        "$case_of_liver/deformed_surface.obj" --method icp -o no-such-folder/x.vtk
else
    skip "no livers for register_liver"
fi

# ---- insilico ----
expect 0 '^insilico \[MODEL\]' insilico --help
long expect 0 'study_box.svg written' insilico --coarse 6 --fine 9 --patterns instrument,gravity --methods all -o study_box.svg
long check "a row for each method and pattern" [ "$(grep -c '^  \(pbsm\|pbsm-laplace\|nicp\|icp\|cpd\|infer\) ' output.txt)" = 12 ]
long check "boxes of six methods" eval '[ "$(grep -c "<path fill=\"none\"" study_box.svg)" = 6 ]'
expect 0 'the visible part' insilico --coarse 6 --fine 9 --patterns gravity --methods nicp --partial --noise 0.5 --fix
expect 0 'the visible part' insilico --coarse 6 --fine 9 --patterns gravity --methods infer --from 0,-1,0.5 --seen 30 --noise 1
expect 2 '0,0,0 is no direction' insilico --from 0,0,0
expect 2 'is not X,Y,Z' insilico --from up
expect 2 'needs a number from 0.01 to 100' insilico --seen 0
expect 0 'svg written' insilico --coarse 6 --fine 9 --patterns respiration --methods icp --outliers 10 -o out.svg
expect_data 0 'respiration: deformed by' insilico surfaces/liver_a.obj --coarse 6 --fine 9 --patterns respiration \
    --methods icp
expect 2 'is none of: respiration' insilico --patterns swimming
expect 2 'is none of: pbsm' insilico --methods magic
expect 2 'no-such-file.vtk' insilico no-such-file.vtk
expect 2 'no-such-folder' insilico --coarse 4 --fine 5 --patterns gravity --methods icp -o no-such-folder/x.svg

# ---- studies in shards: any number of them, killed and run again, gives the bytes of one run ----
study="--coarse 4 --fine 5 --patterns instrument,gravity --methods icp --seeds 2 --noise 1"
tools=$here/../examples/study
expect 0 '^study: 4 cases, shard 1 of 1, 4 to do' insilico $study --study whole.csv
check "a row for each case" [ "$(wc -l <whole.csv | tr -d ' ')" = 6 ]
for shard in 1 2 3; do expect 0 "shard $shard of 3, [12] to do" insilico $study --study part.$shard --shard $shard/3; done
check "three shards are merged" sh "$tools/merge.sh" merged.csv part.1 part.2 part.3
check "to the same bytes" cmp -s merged.csv whole.csv
head -c $(($(wc -c <whole.csv) - 9)) whole.csv >torn.csv
expect 0 'shard 1 of 1, 1 to do' insilico $study --study torn.csv
check "a torn line is done again" cmp -s torn.csv whole.csv
(exec "$programs/insilico" $study --study killed.csv >/dev/null 2>&1) &
killed=$! tries=0
while [ "$({ wc -l <killed.csv || echo 0; } 2>/dev/null)" -lt 3 ] && [ $tries -lt 300 ]; do
    sleep 0.1
    tries=$((tries + 1))
done
kill -9 $killed 2>/dev/null
wait $killed 2>/dev/null
expect 0 'shard 1 of 1, [0-3] to do' insilico $study --study killed.csv
check "a killed study goes on" cmp -s killed.csv whole.csv
expect 0 'shard 1 of 1, 0 to do' insilico $study --study killed.csv
expect 2 'is of another study' insilico $study --seed 7 --study whole.csv
head -c 20 whole.csv >torn.csv
expect 0 'shard 1 of 1, 4 to do' insilico $study --study torn.csv
check "a torn heading is written again" cmp -s torn.csv whole.csv
printf '\0bytes' >bytes.bin
cp bytes.bin kept.bin
expect 2 'is of another study' insilico $study --study bytes.bin
check "a file of something else stays" cmp -s bytes.bin kept.bin
expect 2 'has a line that is not of this shard' insilico $study --study whole.csv --shard 2/3
expect 2 'needs I/N with 1 <= I <= N' insilico $study --study x.csv --shard 4/3
expect 2 'needs --study FILE' insilico --shard 1/3
expect 2 'no-such-folder/x.csv: cannot be written' insilico $study --study no-such-folder/x.csv
check "no shard may be missing" refuses "case 2 is missing" sh "$tools/merge.sh" none.csv part.1 part.2
check "nor be there twice" refuses "is there twice" sh "$tools/merge.sh" none.csv part.1 part.2 part.2 part.3
head -c $(($(wc -c <part.3) - 4)) part.3 >torn.3
check "nor be cut off" refuses "torn.3: its last line is cut off" sh "$tools/merge.sh" none.csv part.1 part.2 torn.3
(cat part.3 && echo 4,1,gravity) >more.3
check "nor have cases of its own" refuses "is no case of it" sh "$tools/merge.sh" none.csv part.1 part.2 more.3
check "nothing is written then" is_gone none.csv
if command -v parallel >/dev/null; then
    mkdir -p "a folder"
    check "by GNU parallel" quietly sh "$tools/parallel.sh" 3 "a folder/dealt.csv" "$programs/insilico" $study
    check "to the same bytes" cmp -s "a folder/dealt.csv" whole.csv
else
    skip "no GNU parallel"
fi
SLURM_ARRAY_TASK_ID=2 SLURM_ARRAY_TASK_COUNT=3 sh "$tools/slurm.sh" task "$programs/insilico" $study >/dev/null 2>&1
check "a task of Slurm is a shard" cmp -s task.2.csv part.2

# ---- igtl_server, igtl_client: in two processes ----
expect 0 '^usage: igtl_server' igtl_server --help
expect 0 '^usage: igtl_client' igtl_client --help
"$programs/igtl_server" --port 0 --cells 5 --seconds 300 >server.txt 2>&1 &
server=$! tries=0 port=
while [ -z "$port" ] && [ $tries -lt 100 ]; do
    sleep 0.2
    port=$(sed -n 's/^listening .*:\([0-9]*\),.*/\1/p' server.txt)
    tries=$((tries + 1))
done
expect 0 '^pressed  *60 mm down: up to [0-9.]* N' igtl_client --port "${port:-1}" --frames 30
check "the organ gave way, and was pulled" awk '/^pressed/ { force = $7 } /^moved/ { a = $2; b = $5 }
    END { exit !(force > 0.1 && a > 10 && b > 5) }' output.txt
check "answers are timed" grep -q '^round trips  30 of [0-9.]* kB: median [0-9.]* ms' output.txt
expect 2 'cannot be listened on' igtl_server --port "${port:-1}" --seconds 1
kill $server
wait $server 2>/dev/null
expect 3 'no server; is igtl_server running' igtl_client --port "${port:-1}"
expect 2 'no-such.vtk' igtl_server no-such.vtk
expect_data 2 'is a surface' igtl_server surfaces/liver_a.obj
expect 2 '--rate needs a number' igtl_server --rate 0
expect 2 '--trips needs a whole number' igtl_client --trips none
expect 2 'here is one word too many' igtl_client here

# ---- drop ----
expect 0 '^usage: drop' drop --help
expect 0 '^rest=[01] floor_over_weight=[0-9.]* overlap_mm=[0-9.]* step_ms=' drop --count 2 --cells 3 -o drop
check "the floor carries the weight" holds "$(last floor_over_weight) > 0.99 && $(last floor_over_weight) < 1.01"
check "drop.png is a picture" is_png drop.png
check "a row for each step" [ "$(wc -l <drop.csv | tr -d ' ')" = 241 ]
expect 0 '^rest=' drop --count 1 --cells 2 --seconds 0.1 --self --series fallen -o drop
check "a series of the steps" [ "$(ls fallen_*.vtk | wc -l | tr -d ' ')" = 6 ]
long expect_data 0 '^rest=' drop volumes/liver_a_tet4_2k.vtk --count 2 --seconds 0.5 -o organ
expect 2 '--count needs a whole number from 1 to' drop --count 0
expect 2 '--speed needs a number from' drop --speed -1
expect 2 'hard is no option\|--hard is no option' drop --hard
expect 2 'no-such.vtk' drop no-such.vtk
expect_data 2 'is a surface' drop surfaces/liver_a.obj
expect 2 'no-such-folder/x.csv: cannot be written' drop --count 1 --cells 2 --seconds 0.1 -o no-such-folder/x

# ---- breathing ----
expect 0 '^usage: breathing' breathing --help
breathe="breathing --cells 6 --period 1 --beat 0"
for diaphragm in '' --bound; do
    expect 0 '^target_mm=[0-9.]* largest_mm=[0-9.]* force_N=[0-9.]* frames=60 median_ms=' $breathe --seconds 1 $diaphragm -o breath
    check "it goes with the diaphragm" holds "$(last target_mm) > 5 && $(last largest_mm) < 17 && $(last force_N) > 1"
    check "it comes back" awk -F, 'END { exit !($4 < 0.5 && $5 < 1) }' breath.csv
    check "no volume is lost" awk -F, 'NR > 1 { v = $7 < 0 ? -$7 : $7; if (v > 2) bad = 1 } END { exit bad }' breath.csv
    check "breath.png is a picture" is_png breath.png
done
check "a row for each frame" [ "$(wc -l <breath.csv | tr -d ' ')" = 61 ]
check "a chart of three panels" [ "$(grep -c 'time (s)' breath.svg)" = 3 ]
expect 0 'heart 2 mm at 120 a minute' breathing --cells 4 --breath 0 --pulse 120 --seconds 0.5 --every 10 -o heart
check "a series of the frames" [ "$(ls heart_*.vtk | wc -l | tr -d ' ')" = 3 ]
check "the heart pushes" holds "$(last largest_mm) > 0.5 && $(last force_N) > 0"
expect 0 '^target_mm=0 largest_mm=0 force_N=0 ' breathing --cells 4 --breath 0 --beat 0 --seconds 0.1 --bound -o still
long expect_data 0 '^target_mm=' breathing volumes/liver_a_tet4_2k.vtk --seconds 1 -o organ
expect 2 '--breath needs a number from' breathing --breath 1
expect 2 '--rate needs a number from' breathing --rate 0
expect 2 '--hard is no option' breathing --hard
expect 2 'no-such.vtk' breathing no-such.vtk
expect_data 2 'is a surface' breathing surfaces/liver_a.obj
expect 2 'no-such-folder/x.csv: cannot be written' breathing --cells 4 --seconds 0.1 -o no-such-folder/x

# ---- cut_scalpel ----
expect 0 '^usage: cut_scalpel' cut_scalpel --help
expect 0 '^parts=1 gape_mm=[0-9.]* links=[0-9]* cells=[0-9]* nodes=[0-9]* frames=[0-9]*$' cut_scalpel --write-stroke path.txt
check "the cut opens under the organ's weight" holds "$(last gape_mm) > 15 && $(last gape_mm) < 50"
check "cut_scalpel.png is a picture" is_png cut_scalpel.png
check "a row for each frame" [ "$(wc -l <cut_scalpel.csv | tr -d ' ')" = "$(($(last frames) + 1))" ]
check "the series names its files" \
    [ "$(grep -c '"name": "cut_scalpel_00' cut_scalpel.vtk.series)" = "$(($(last frames) / 10))" ]
check "skin and lips in a file" grep -a -q '^SCALARS lip' cut_scalpel_0010.vtk
cut="cut_scalpel --cells 6 --every 10 --rate 30 --rest 0.1"
expect 0 '^parts=2 .* frames=41$' $cut --depth 1 --speed 0.2 --write-stroke through.txt --frames 41 -o through
expect 0 '^parts=2 .* frames=41$' $cut --stroke through.txt --frames 41 -o again
for file in .csv .png _0003.vtk; do
    check "the same stroke from a file: $file" cmp -s through$file again$file
done
expect 0 '^parts=1 .* frames=1$' $cut --lattice 4 --frames 1 --every 0 -o odd
check "no series unless asked for" is_gone odd.vtk.series
long expect_data 0 '^parts=1' cut_scalpel volumes/liver_a_tet4_2k.vtk --lattice 1 --frames 60 -o organ
long expect_data 0 '^parts=1' cut_scalpel volumes/liver_a_tet10_1k.vtk --lattice 1 --frames 60 -o organ
expect 0 '^parts=1 ' cut_scalpel --quadratic --cells 6 --young 20000 --front glue --frames 20 --every 0 -o quadratic
bad_stroke() { # bad_stroke WORDS TEXT: the file of strokes is refused
    printf "$2" >bad.txt
    expect 2 "^cut_scalpel: bad.txt$1" cut_scalpel --cells 4 --stroke bad.txt
}
bad_stroke ': has no stroke' '# nothing\n'
bad_stroke ':1: stands before the first line' '0 1 2 3 4 5 6\n'
bad_stroke ':2: needs the time and three numbers' 'stroke\n0 1 2 3 4 5\n'
bad_stroke ':2: needs finite numbers' 'stroke\n0 1 2 nan 4 5 6\n'
bad_stroke ':2: needs finite numbers' 'stroke\n0 1 2 3x 4 5 6\n'
bad_stroke ':3: has another number of corners' 'stroke\n0 1 2 3 4 5 6\n1 1 2 3 4 5 6 7 8 9\n'
bad_stroke ':4: needs a later time' 'stroke\n\n1 1 2 3 4 5 6\n1 1 2 3 4 5 6\n'
bad_stroke ':3: the stroke before has fewer' 'stroke\n0 1 2 3 4 5 6\nstroke\n'
bad_stroke ':1: `stroke` stands alone' 'stroke of genius\n'
bad_stroke ':2: has more than 8 corners' "stroke\n$(seq 0 27 | tr '\n' ' ')\n"
bad_stroke ':2: is longer than' "stroke\n$(seq 0 900 | tr '\n' ' ')\n"
expect 2 'no-such.txt: cannot be read' cut_scalpel --cells 4 --stroke no-such.txt
expect 2 '--lattice needs 1, 2 or 4' cut_scalpel --lattice 3
expect 2 '--front needs lag or glue' cut_scalpel --front lead
expect 2 '--depth needs a number from' cut_scalpel --depth 2
expect 2 '--deep is no option' cut_scalpel --deep 2
expect 2 'no-such.vtk' cut_scalpel no-such.vtk
expect_data 2 'is cut as tet4 or tet10 only' cut_scalpel volumes/beam_hex8.vtk
expect_data 2 'is a surface' cut_scalpel surfaces/liver_a.obj
expect 3 'does not come to rest' cut_scalpel --cells 4 --young 10
expect 2 'no-such-folder/x.csv: cannot be written' $cut --frames 1 --every 0 -o no-such-folder/x

# ---- cautery ----
expect 0 '^usage: cautery' cautery --help
burn="cautery --cells 6 --rate 30 --speed 0.1 --passes 1 --rest 0.1 --lattice 2"
expect 0 '^removed_ml=[0-9.]* removed_g=[0-9.]* left_g=[0-9.]* parts=1 frames=[0-9]*$' $burn --write-path way.txt --every 5
check "something was burnt" holds "$(last removed_ml) > 1 && $(last removed_ml) < 100"
check "its weight is that of its volume" holds "$(last removed_g) / $(last removed_ml) > 1.05 && $(last removed_g) / $(last removed_ml) < 1.07"
check "cautery.png is a picture" is_png cautery.png
check "a row for each frame" [ "$(wc -l <cautery.csv | tr -d ' ')" = "$(($(last frames) + 1))" ]
check "walls of the hole in a file" grep -a -q '^SCALARS lip' cautery_0003.vtk
expect 0 '^removed_ml=' $burn --path way.txt --every 5 -o again
for file in .csv .png _0003.vtk; do
    check "the same way from a file: $file" cmp -s cautery$file again$file
done
printf '0 0 0 0\n1 0 0 0.1\n' >out.txt
expect 0 '^removed_ml=[0-9.]* removed_g=[0-9.]* left_g=0.0000 parts=0 frames=2$' cautery --cells 4 --path out.txt --radius 1 --frames 2 --every 0 -o all
expect 0 '^removed_ml=[0-9.]* removed_g=[0-9.]* left_g=0.0000 parts=0 frames=2$' cautery --cells 4 --path out.txt --radius 1 --frames 2 --every 1 -o all
long expect_data 0 '^removed_ml=[0-9.]* .* parts=1' cautery volumes/liver_a_tet4_2k.vtk --passes 1 --frames 60 -o organ
bad_way() { # bad_way WORDS TEXT: the file with the way is refused
    printf "$2" >bad.txt
    expect 2 "^cautery: bad.txt$1" cautery --cells 4 --path bad.txt
}
bad_way ': has fewer than two places' '# nothing\n0 1 2 3\n'
bad_way ':1: needs four finite numbers' '0 1 2\n'
bad_way ':1: needs four finite numbers' '0 1 2 nan\n'
bad_way ':2: needs a later time' '1 1 2 3\n1 1 2 3\n'
bad_way ':1: has a time below 0' ' -1 1 2 3\n'
expect 2 'no-such.txt: cannot be read' cautery --cells 4 --path no-such.txt
expect 2 '--lattice needs 1, 2 or 4' cautery --lattice 3
expect 2 '--radius needs a number from' cautery --radius 0
expect 2 '--deep is no option' cautery --deep 2
expect 2 'no-such.vtk' cautery no-such.vtk
expect_data 0 '^removed_ml=14\.2.* parts=1' cautery volumes/liver_a_tet10_1k.vtk
expect 2 'no-such-folder/x.csv: cannot be written' $burn --frames 1 --every 0 -o no-such-folder/x

# ---- ablation ----
expect 0 '^usage: ablation' ablation --help
burn="ablation --cells 8 --time 120 --cool 30 --depth 0.04"
expect 0 '^dead_ml=[0-9.]* highest_c=[0-9.]* balance=[0-9.e-]*$' $burn
check "something died" holds "$(last dead_ml) > 0.5 && $(last dead_ml) < 50"
check "the generator kept its limit" holds "$(last highest_c) > 60 && $(last highest_c) < 105"
check "the balance of heat closes" holds "$(last balance) < 1e-8"
check "ablation.png is a picture" is_png ablation.png
check "a row every ten seconds" [ "$(wc -l <ablation.csv | tr -d ' ')" = 16 ]
check "both fields in a file" grep -a -q '^SCALARS dead_share' ablation.vtk
expect 0 '^dead_ml=' $burn --keep --dead -o kept
check "blood that flows on takes more heat" holds "$(tail -n 1 kept.csv | cut -d , -f 6) > $(tail -n 1 ablation.csv | cut -d , -f 6)"
expect 0 '^dead_ml=0.000 highest_c=37.0' $burn --power 0 -o cold
expect 2 'comes out of the organ below' ablation --cells 8 --depth 0.9
expect 2 'meets no organ there' ablation --cells 8 --x 0 --y 0
expect 2 '--power needs a number from' ablation --power -1
expect 2 '--hot is no option' ablation --hot 2
expect 2 'no-such.vtk' ablation no-such.vtk
expect_data 2 'is a surface' ablation surfaces/liver_a.obj
long expect_data 0 '^dead_ml=[0-9.]* ' ablation volumes/liver_a_tet10_1k.vtk --time 60 --cool 0
expect 2 'no-such-folder/x.csv: cannot be written' $burn -o no-such-folder/x

# ---- cut_resect ----
expect 0 '^usage: cut_resect' cut_resect --help
expect 0 '^parts=2 resected_ml=[0-9.]* resected_g=[0-9.]* tumour_ml=[0-9.]* margin_mm=[0-9.]* carried=[0-9.]*$' cut_resect
check "the margin is near what was planned" holds "$(last margin_mm) > 7.5 && $(last margin_mm) < 8.5"
check "the wedge weighs what it measures" holds "$(last resected_g) / $(last resected_ml) / 1.06 > 0.9999 &&
    $(last resected_g) / $(last resected_ml) / 1.06 < 1.0001 && $(last resected_ml) > $(last tumour_ml)"
check "the grasper carries its weight" holds "$(last carried) > 0.99 && $(last carried) < 1.01"
check "cut_resect.png is a picture" is_png cut_resect.png
check "the tumour is in the series" [ "$(grep -c '"name": "cut_resect_tumour_' cut_resect_tumour.vtk.series)" -gt 5 ]
cube tumour.obj 0.016
resect="cut_resect --cells 8 --every 0 --tumour tumour.obj"
expect 0 '^parts=2 .* tumour_ml=4.10 ' $resect --lattice 1 -o cube
check "no series unless asked for" is_gone cube.vtk.series
expect 0 '^parts=2 ' $resect --lattice 1 -o again
for file in .csv .png; do
    check "the same wedge again: $file" cmp -s cube$file again$file
done
expect 0 'margin_mm=-\{0,1\}0' $resect --lattice 4 --margin 0 --lift 0 -o odd
long expect_data 0 '^parts=2' cut_resect volumes/liver_a_tet4_2k.vtk --every 0 -o organ
height_of_part() { sed -n 's/^part 0 .*centre (.*, \(.*\)) mm, held$/\1/p' output.txt; } # mm, of what stays on the table
expect 0 '^parts=2 ' cut_resect --cells 6 --every 0 --lift 0 -o linear
linear=$(height_of_part)
expect 0 '^parts=2 ' cut_resect --quadratic --cells 6 --every 0 --lift 0 -o quadratic
check "organs of both elements lie as high on the table: $linear, $(height_of_part) mm" awk -v a="$linear" \
    -v b="$(height_of_part)" 'BEGIN { exit !(a < -3 && b - a < 1 && a - b < 1) }'
expect 2 'the wedge: does not come loose' $resect --margin 0.5
expect 2 'far.obj: sticks out of the organ' cut_resect --cells 8 --tumour far.obj
expect 2 'open.obj: .*edges of one face only' cut_resect --cells 8 --tumour open.obj
expect 2 'the tumour: sticks out of the organ' cut_resect --cells 8 --depth 0.002
expect 2 'the tumour: has no organ there' cut_resect --cells 8 --x 0
expect 2 'no-such.obj' cut_resect --cells 8 --tumour no-such.obj
expect 2 'volume.vtk: is no surface of triangles' cut_resect --cells 8 --tumour volume.vtk
expect 2 '--lattice needs 1, 2 or 4' cut_resect --lattice 3
expect 2 '--front needs lag or glue' cut_resect --front lead
expect 2 '--angle needs a number from' cut_resect --angle 90
expect 2 '--wide is no option' cut_resect --wide 2
expect_data 2 'is cut as tet4 or tet10 only' cut_resect volumes/beam_hex8.vtk
expect 2 'no-such-folder/x.csv: cannot be written' $resect --lift 0 -o no-such-folder/x

# ---- cut_force ----
expect 0 '^usage: cut_force' cut_force --help
expect 0 '^most=[0-9.]* work_J=[0-9.]* area_mm2=[0-9.]* frames=180$' cut_force
check "a push takes toughness times width" holds "$(last most) > 0.95 * 150 * 0.04 && $(last most) < 1.15 * 150 * 0.04"
check "the work is that of the area" holds "$(last work_J) > 0.95 * 150e-6 * $(last area_mm2) &&
    $(last work_J) < 1.0001 * 150e-6 * $(last area_mm2)"
check "a chart" grep -q '</svg>' cut_force.svg
check "a row for each frame of three cuts" [ "$(wc -l <cut_force.csv | tr -d ' ')" = 541 ]
force="cut_force --cells 4"
expect 0 '^close .* J_c 100 J/m2: .* mN m at most' $force --scissors --toughness 100 --speed 0.2 -o close
expect 0 '^close .* 150.0 J/m2 with 0[.]0*[1-9][0-9]* J not felt yet' $force --steps --scissors --speed 0.2 -o owed
expect 0 '^most=0.000 work_J=0.00000' $force --toughness 0 --speed 0.2 -o none
expect 0 '^most=' $force --steps --toughness 5 --young 200000 --speed 0.2 --lattice 1 --front lag -o steps
expect 0 '^most=' $force --steps --toughness 5 --young 200000 --speed 0.2 --lattice 1 --front lag -o again
for file in .csv .svg; do
    check "the same cut again: $file" cmp -s steps$file again$file
done
expect 2 '--lattice needs 1, 2 or 4' cut_force --lattice 3
expect 2 '--front needs lag or glue' cut_force --front lead
expect 2 '--toughness needs a number from' cut_force --toughness -1
expect 2 'is one word too many' cut_force organ.vtk
expect 2 'no-such-folder/x.csv: cannot be written' $force --speed 1 -o no-such-folder/x

# ---- cut_study ----
long expect 0 '^sag_order=[0-9.]* opening_order=[0-9.]* force_order=[0-9.]* sag_mm=34.2' cut_study --quick -o cuts
long check "quadratic cuts that are glued are as near as a mesh made for them" awk -F, '
    $1 == "tet10 by hand" { sag[++n] = $7; force[n] = $9 }
    $1 == "tet10 glue" { m++; if ($7 > 1.3 * sag[m] || $9 > 1.3 * force[m]) bad = 1 }
    END { exit !(n == 2 && m == 2 && !bad) }' cuts.csv
long check "errors fall" awk -F, 'NR > 1 { if ($1 == name && $7 > 0.7 * last) bad = 1; name = $1; last = $7; n++ }
    END { exit !(n == 16 && !bad) }' cuts.csv
long check "branch functions have smaller errors than a mesh made for the cut, within a reach by an order above 1.2" awk -F, '
    $1 == "tet4 by hand" { sag = $7; force = $9 }
    $1 == "tet4 branch" && $2 < 10 && !($7 < sag && $9 < 0.75 * force) { bad = 1 }
    $1 == "tet4 branch 20" { if (++n == 1) { h = $2; first = $7 } else order = log(first / $7) / log(h / $2) }
    END { exit !(n == 2 && !bad && order > 1.2) }' cuts.csv
long check "the plate's stress intensity: glued within 2 %, a lag that shows" awk -F, '
    $1 == "tet10 glue" { n++; if ($5 > 0.02) bad = 1 }
    $1 == "tet10 lag" && $2 == 11 { m++; if ($5 < 0.05) bad = 1 }
    END { exit !(n == 2 && m == 1 && !bad) }' cuts_plate.csv
long check "a chart of four panels" eval '[ "$(grep -c "relative error" cuts.svg)" = 4 ]'
expect 0 '^branch within 0.2' cut_study --branch -o front
check "a chart of branch functions" grep -q '</svg>' front_branch.svg
# Against figures of another program: errors in percent of 21 and 41 cells (20 and 40 by hand), each to 1.
check "branch functions, jumps alone and a mesh made for the crack have the errors that they should" awk -F, '
    BEGIN { split("15.5 8 26 14 7.2 3.7 4.7 1.5 3.3 0.9", known, " ") }
    NR > 1 && $2 >= 20 && $1 !~ /^embedded/ { n++; off = 100 * $5 - known[n]; if (off > 1 || off < -1) bad = 1 }
    END { exit !(n == 10 && !bad) }' front_branch.csv
check "at the tip they halve the error of a mesh made for the crack, within a reach they mend its order" awk -F, '
    $1 == "by hand" { hand[++h] = $5 } $1 == "branch at the tip" && $5 > 0.56 * hand[++t] { bad = 1 }
    $1 == "branch within 0.2" { if (cells) order = log($5 / last) / log($2 / cells); last = $5; cells = $2 }
    END { exit !(h == 3 && t == 3 && !bad && order < -1.8) }' front_branch.csv
check "embedded within a reach they have half the error of continuous ones, and fall faster than the square" awk -F, '
    $1 == "branch within 0.2" { branch[$2] = $5 }
    $1 == "embedded within 0.2" { n++; if ($5 > (n == 1 ? 0.6 : 0.5) * branch[$2]) bad = 1
        if (n == 1) { first = $5; cells = $2 } order = log(first / $5) / log($2 / cells) }
    END { exit !(n == 3 && !bad && order > 2) }' front_branch.csv
check "at a tip, moderate costs of jumps have a third of the error of high ones, which leave jumps alone" awk -F, '
    FNR == NR { if ($1 == "jumps alone" && $2 == 21) jumps = $5; next }
    $1 == "at the tip" { error[$2] = $4; n++ }
    END { exit !(n == 6 && error[1] < error[10000] / 3 && error[10000] < jumps && error[10000] > 0.9 * jumps) }' front_branch.csv front_beta.csv
long expect 2 'no-such-folder/x_branch.csv: cannot be written' cut_study --branch -o no-such-folder/x
expect 0 '^usage: cut_study' cut_study --help
expect 2 '--lattice needs 1, 2 or 4' cut_study --lattice 3
expect 2 'is one word too many' cut_study beam.vtk

# ---- needle_study ----
long expect 0 'needles_step.svg written' needle_study --quick -o needles
long check "14 rows and a head of CSV" eval '[ "$(wc -l <needles.csv | tr -d " ")" = 15 ]'
long check "charts of three and two panels" eval '[ "$(grep -c "edge (mm)" needles_mesh.svg)" = 3 ] &&
    [ "$(grep -c "step (ms)" needles_step.svg)" = 2 ]'
# the base is as stiff as that of a solid needle to 8 %, tips come as far aside in both meshes to 5 %
long check "needles hardly depend on the mesh" awk -F, '
    $1 == "base stiffness" { r = $4 / ($2 ~ /^steel/ ? 1354 : 497); if (r < 0.92 || r > 1.08) bad = 1; n++ }
    $1 == "tip aside" { if (seen[$2] && ($4 / seen[$2] > 1.05 || $4 / seen[$2] < 0.95)) bad = 1; seen[$2] = $4; n++ }
    $1 == "shaft off its way" { if ($4 > 0.05) bad = 1; n++ }
    END { exit !(n == 10 && !bad) }' needles.csv
expect 0 '^needle_study \[OPTIONS\]' needle_study --help
expect 2 'no-such-folder' needle_study --quick -o no-such-folder/study

# ---- a full disk ----
all="hello custom_element demo viscoelastic liver_models surface_to_sim cylinder_study umesh particles_study needle_prostate needle_forces
    needle_control needle_obstacles needle_phantom one_body register_liver insilico case_solve haptic_loop grasp
    palpation track_liver drop breathing cut_scalpel cut_resect cut_force cut_study
    needle_study igtl_server igtl_client"
# full_stdout PROGRAM [ARGUMENT...]: what is printed cannot be written, which is told, and is no success
full_stdout() {
    program=$1
    shift
    "$programs/$program" "$@" >/dev/full 2>output.txt
    got=$?
    if [ $got != 0 ] && [ $got -lt 126 ] && grep -q '^'"$program"': .*\(cannot be written\|No space\)' output.txt; then
        pass
    else
        fail "$program $*, full stdout: exit status $got"
    fi
}
# full_disk FILE PROGRAM [ARGUMENT...]: FILE is there and cannot be written: it stays, alone, and the program says so
full_disk() {
    file=$1 program=$2
    shift 2
    rm -rf full
    mkdir full
    echo old >"full/$file"
    {
        trap '' XFSZ
        ulimit -f 0
        "$programs/$program" "$@" 2>&1
        echo "exit status $?"
    } | cat >output.txt
    if ! grep -q '^exit status 0$' output.txt && grep -q "^\($program\|full.case[:0-9]*\): .*\(full/$file\|written\)" output.txt &&
        [ "$(cat "full/$file")" = old ] && [ "$(ls full)" = "$file" ]; then
        pass
    else
        fail "$program $*, full disk: $(tail -n 2 output.txt), folder: $(ls full)"
    fi
}
if [ -c /dev/full ]; then
    for program in $all; do
        [ $program = hello ] || full_stdout $program --help
    done
    full_stdout hello
    full_stdout custom_element -n 1
    full_stdout viscoelastic --points 30
else
    skip "no /dev/full"
fi
if (trap '' XFSZ && ulimit -f 0 && ! echo text >probe) 2>/dev/null; then
    full_disk x.csv umesh evaluate beams.csv beam.sbnet $beam --solves 1 -o full/x
    full_disk x.sbnet umesh train beams.csv full/x.sbnet $beam --channels 1 --epochs 1
    full_disk x.csv grasp --way 0.001 -o full/x
    full_disk x.csv $track -o full/x
    full_disk x.csv palpation --cells 6 --size 0.012 --grid 5 -o full/x
    full_disk x.csv drop --count 1 --cells 2 --seconds 0.1 -o full/x
    full_disk x.csv breathing --cells 4 --seconds 0.1 -o full/x
    full_disk x.csv cut_scalpel --cells 4 --frames 1 --every 0 -o full/x
    full_disk x.csv $resect --lift 0 -o full/x
    full_disk x.csv $force --speed 1 -o full/x
    full_disk x.vtk custom_element -n 1 -o full/x.vtk
    full_disk demo.png demo --no-vtk --frames 10 -o full
    full_disk demo_0000.vtk demo --frames 10 --every 5 -o full
    full_disk x.csv viscoelastic --points 30 -o full/x
    full_disk x.svg viscoelastic --points 30 -o full/x
    full_disk x.csv haptic_loop --turns --seconds 1 -o full/x
    full_disk respiration_0.vtk liver_models --cells 4 --steps 1 -o full
    full_disk x.vtk surface_to_sim box.obj --cells 4 --steps 1 -o full/x.vtk
    full_disk mesh.vtk surface_to_sim box.obj --cells 4 --steps 0 --mesh full/mesh.vtk
    full_disk x.csv needle_prostate --seconds 0.5 --csv full/x.csv -o full/y
    full_disk x_0000.vtk needle_prostate --seconds 0.5 -o full/x
    full_disk x_stick_slip.svg needle_forces -o full/x
    full_disk x.csv needle_control --targets 1 -o full/x
    full_disk x.csv needle_obstacles -o full/x
    full_disk x_single.csv needle_phantom --bend single --cells 4 --depth 0.02 -o full/x
    surface_mesh="surface_to_sim box.obj --cells 4 --steps 0 --mesh full_case.vtk"
    "$programs"/$surface_mesh >/dev/null && seq 0 20 >full_nodes
    printf '%s\n' 'mesh full_case.vtk' 'material corotated E=1000 nu=0.3 density=1000' 'gravity 0 0 -1' \
        'fix xyz nodes=full_nodes' 'solve static steps=1 tol=1e-6' 'output displacement full/x.txt' >full.case
    full_disk x.txt case_solve full.case
    sed -i.old '/^output/d' full.case
    full_disk x.vtk case_solve full.case full/x.vtk
    if [ -n "$data" ] && [ -e "$case_of_liver/coarse_tet4.vtk" ]; then
        for file in -o --displacement --targets-out; do
            full_disk x.txt register_liver "$case_of_liver/coarse_tet4.vtk" "$case_of_liver/deformed_surface.obj" \
                --method icp --aligned --targets points.txt --targets-out other.txt $file full/x.txt
        done
    fi
    full_disk x.svg insilico --coarse 4 --fine 5 --patterns gravity --methods icp -o full/x.svg
else
    skip "the size of files cannot be limited"
fi

echo "$passed passed, $failed failed, $skipped skipped"
[ "$failed" = 0 ]
