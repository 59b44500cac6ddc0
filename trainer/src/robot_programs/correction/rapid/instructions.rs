//! Instructions and functions of RAPID that every controller has, to tell them from routines that are in none of the files.

use crate::robot_programs::correction::flow::Step;
use crate::robot_programs::correction::program::Location;
use crate::robot_programs::correction::rapid::Reader;
use crate::robot_programs::correction::rapid::changes::{KEYWORDS, READING};
use crate::robot_programs::correction::rapid::others::PROCESSES;
use crate::robot_programs::correction::rapid::statements::{Statement, is_instruction};
use crate::robot_programs::correction::tokens::Kind;

/// Names in lower case, besides those of motions and of the lists above. ("RAPID Instructions, Functions and Data types",
/// 3HAC050917.)
const OWN: &str = "\
    accset actunit add ainput aliascamera aliasio aliasioreset aoutput arcrefresh argname bitand bitcheck bitclear \
    bitlsh bitneg bitor bitrsh bitset bitxor bookerrno break bytetostr callbyvar cancelload canceload cdate cfgload \
    checkprogref circpathmode clear cleariobuff clearpath clearrawbytes clkread clkreset clkstart clkstop close \
    closedir cmotorcurrent cnvgenread confj confl connect copyfile copyrawbytes corrclear corrcon corrdiscon \
    corrread corrwrite cspeedoverride ctime ctool deactunit decr dectohex delay deletefile dinput doutput \
    dropsensor dropwobj egmactjoint egmactmove egmactpose egmgetid egmgetstate egmreset egmrunjoint egmrunpose \
    egmsetupai egmsetupao egmsetupgi egmsetupltapp egmsetupuc egmstop egmstreamstart egmstreamstop eoffsoff eoffson \
    eoffsset erasemodule errlog errorinfo errraise errwrite eventtype execengine execlevel exit exitcycle fcact \
    fccalib fcconditionforce fcconditionwaitwhile fcdeact fcrefcircle fcrefforce fcrefline fcrefrot fcrefspiral \
    fcrefstart fcrefstop fcsetdampingtune fcspdchgact fcspdchgdeact fcspdchgtunset filesize filetime fssize \
    getdataval getmechunitname getmodalpaymode getmotorbraketorque getnextmechunit getnextoption getnextsym \
    getservicing getsignalorigin getsymbolname getsysdata getsysinfo gettaskname gettime ginput goutput grouptype \
    hextodec hollowwristreset idisable ienable incr indcnv indinpos indreset indspeed invertdo iodisable ioenable \
    iounitstate ipathpos isbrakecheckactive iscyclicbool isfile isignalai isignalao isignaldi isignaldo isignalgi \
    isignalgo ismechunitactive isstopmoveact isstopstateevent issyncmoveon itimer ivarvalue iwatch load loadid \
    makedir manloadidproc maxexttcpspeed maxrobspeed mechunitload mirpos modexist modtime motionplannerno \
    motionprocessmodeset motionsup mtorquelimit nonmotionmode numtostr open opendir oprmode orobt packdnheader \
    packrawbytes partyp pathaccmax pathlengthget pathlengthreset pathlengthstart pathlengthstop pathlevel \
    pathrecmovebwd pathrecmovefwd pathrecstart pathrecstop pathrecvalidbwd pathrecvalidfwd pathresol \
    pathspeedoverride pdispoff pfrestart powerdownlimit present procerrrecovery pulsedo rawbyteslen readanybin \
    readbin readblock readcfgdata readdir readerrdata readmotor readnum readrawbytes readstr readstrbin readvar \
    readvararr recoverpath removeallcyclicbool removecyclicbool removedir removefile renamefile reset \
    resetaxisdistance resetaxismovetime resetppmoved resetretrycount restopath retry return reverse rewind \
    rmqemptyqueue rmqfindslot rmqgetmessage rmqgetmsgdata rmqgetmsgheader rmqgetslotname rmqreadwait rmqsendmessage \
    rmqsendwait robname robos rolloverchk runmode safetycontrollergetchecksum safetycontrollergetopmodepin \
    safetycontrollergetswversion safetycontrollergetuserchecksum save savecfgdata scgetxn sctwrite searchextj \
    selectworkarea set setalldataval setcyclicbool setdatasearch setdataval setleadthrough simcollision singarea \
    skipwarn socketaccept socketbind socketclose socketconnect socketcreate socketgetstatus socketlisten socketpeek \
    socketreceive socketreceivefrom socketsendto softact softdeact softelbow speedlimaxis speedlimcheckpoint \
    speedrefresh spystart spystop startload startmove startmoveretry stepbwdpath stiowrite stop stopmove \
    stopmovereset storepath strdigcalc strdigcmp strfind strformat strlen strmap strmatch strmemb strorder strpart \
    strtobyte strtonum strtoval supsyncsensoroff supsyncsensoron syncmoveoff syncmoveon syncmoveresume \
    syncmovesuspend syncmoveundo synctosensor systemstopaction taskexecinfo taskisactive taskisexecuting taskruned \
    taskrunmec taskrunrob tasksinsync testandset testdi testsigndefine testsignread testsignreset textget \
    texttabfreetouse texttabget texttabinstall tperase tpreaddnum tpreadfk tpreadnum tpshow triggabort triggcheckio \
    triggdata triggdatacopy triggdatareset triggdatavalid triggequip triggint triggio triggrampao triggspeed \
    triggstopproc tryint trynext tunereset tuneservo uialphaentry uiclientexist uidnumentry uidnumtune uilistview \
    uimessagebox uimsgwrite uimsgwriteabort uinumentry uinumtune uishow unload unpackrawbytes validio valtonum \
    veladj waitai waitao waitdi waitdo waitgi waitgo waitload waitrob waitsensor waitsynctask waittestandset \
    waituntil waitwobj warmstart wristopt writecfgdata writerawbytes writestrbin writevar writevararr wzdisable \
    wzdoset wzenable wzfree wzlimsup";

impl Reader<'_> {
    /// Returns the calls of routines that are in none of the files, with their names.
    pub(super) fn unfound(&self, all: &[Statement]) -> Vec<(String, Location)> {
        let is_known = |name: &str| {
            is_instruction(name)
                || READING.contains(&name)
                || KEYWORDS.contains(&name)
                || PROCESSES.contains(&name)
                || name.starts_with("search")
                || name.starts_with("trigg")
                || OWN.split_whitespace().any(|own| own == name)
        };
        let mut out = Vec::new();
        for s in all {
            let text = self.texts[s.file];
            let first = text.name(s.from);
            let is_declaration = matches!(
                first.as_str(),
                "const" | "pers" | "var" | "local" | "task" | "alias"
            );
            let is_call = |at: &usize| {
                let is_name = text.at(*at).is_some_and(|t| t.kind == Kind::Name);
                is_name && text.is(at + 1, b'(')
            };
            let is_procedure = s.from < s.end
                && !is_declaration
                && matches!(s.step, Step::Other)
                && !is_instruction(&first)
                && text.at(s.from).is_some_and(|t| t.kind == Kind::Name)
                && self.assignment(s).is_none();
            let calls = (s.from..s.end).filter(is_call);
            let calls = is_procedure.then_some(s.from).into_iter().chain(calls);
            out.extend(calls.filter_map(|at| {
                let name = text.name(at);
                let is_found = is_known(&name) || self.routine(&name, s.file).is_some();
                (!is_found).then(|| (text.spelling(at), self.location(s, at)))
            }));
        }
        out
    }
}
